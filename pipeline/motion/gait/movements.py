"""Jumps, squats, sitting down and standing up, from heights of the hips and feet.

A jump is a flight: both feet are off the floor for 0.2 s and more, and the hips fall freely. Take-off and landing are
the corners of the height of the toes. Its height is given twice: by flight time, g t^2 / 8, which holds if the body
lands in the pose of the take-off (Bosco et al. 1983, doi:10.1007/BF00422166), and by the hips, their highest point
above standing.

Squats and seats are dips of the hips while both feet stand. On a seat the body's centre of mass is behind the feet,
where nothing but the seat holds it (``pipeline.motion.balance``).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter1d

from pipeline.motion.gait.events import Corner, rest_begins, rest_ends
from pipeline.motion.gait.points import BodyPoints
from pipeline.motion.skeleton.feet.floor import find_runs

MovementKind = Literal["jump", "squat", "sit_to_stand", "stand_to_sit"]

_GRAVITY_M_S2 = 9.81
# Height of the lower foot above standing, and time, of a flight; least rise of the hips above standing.
_FLIGHT_M, _FLIGHT_S, _LEAST_JUMP_M = 0.03, (0.2, 1.2), 0.03
# Acceleration of the hips in a flight, as a share of gravity: limbs move against them. A person who hangs, or stands on
# the hands, does not fall.
_FALLING = (0.6, 1.5)
# Time around take-off and landing that the fit of a corner covers, on the floor and in the air; share of the flight.
_FLOOR_S, _AIR_S, _AIR_SHARE = 0.15, 0.2, 0.75
_SMOOTH_S = 0.05
# Standing: hips at this share of the straight leg and more, over the ankles.
_STRAIGHT = 0.93
# Heights of the hips as shares of standing: a dip begins and ends at the first; its lowest point is below the second.
_BEGINS, _DEEP = 0.93, 0.82
# Longest way of a foot in a dip, and least and longest time of a squat. Dips that soon after a landing, or before a
# take-off, belong to the jump.
_FOOT_STAYS_M, _SQUAT_S, _OF_JUMP_S = 0.15, (0.5, 8.0), 0.3
# Seat: distance of the centre of mass behind the heels, and time of rest, with hips that move no faster.
_BEHIND_M, _SEATED_S, _RESTING_M_S = 0.03, 0.4, 0.12


@dataclass(frozen=True, slots=True)
class BodyMovement:
    """Movement of a person between two rows of the track; figures are ``None`` where they do not apply."""

    kind: MovementKind
    # Row of its start, such as the take-off, and of its end, such as the landing
    start_row: float
    end_row: float
    duration_s: float
    confidence: float
    height_by_flight_m: float | None = None  # Height of a jump by flight time, of feet with marks
    height_by_hips_m: float | None = None  # Height of a jump by the hips
    depth_m: float | None = None  # Depth of the hips below standing, of squats and seats


def find_movements(points: BodyPoints) -> tuple[BodyMovement, ...]:
    """Find jumps, squats, and sitting down and standing up, in order of their start.

    Only people who stand upright at some time have a standing height to compare with; others have no movements.
    """
    # Above the feet's usual level, so that shares of standing mean something wherever the world's origin is.
    ground_m = _ground_m(points)
    height_m = gaussian_filter1d(points.centre_m[:, 2], _SMOOTH_S * points.frame_rate_hz / 3, mode="nearest") - ground_m
    standing_m = _standing_m(points, ground_m)
    if standing_m is None:
        return ()
    jumps = _jumps(points, ground_m + standing_m)
    dips = _dips(points, height_m, standing_m, jumps)
    return tuple(sorted((*jumps, *dips), key=lambda movement: movement.start_row))


def _ground_m(points: BodyPoints) -> float:
    """Height of the standing ankles in the world."""
    return float(np.quantile(points.ankles_m[points.known.all(1)][..., 2], 0.1))


def _standing_m(points: BodyPoints, ground_m: float) -> float | None:
    """Height of the standing person's hips above the ankles: the median where legs are straight, best on the floor."""
    above_m = points.centre_m[:, 2] - points.ankles_m[..., 2].mean(1)
    straight = (above_m > _STRAIGHT * points.leg_m) & points.known.all(1)
    stands = straight & (points.lowest_m.max(1) < _FLIGHT_M)
    # A drop jump may have no stance but the one on the box.
    for rows, height_m in ((stands, points.centre_m[:, 2] - ground_m), (straight, above_m)):
        if rows.sum() >= 0.2 * points.frame_rate_hz:
            return float(np.median(height_m[rows]))
    return None


def find_flights(points: BodyPoints) -> list[tuple[int, int]]:
    """Find rows from start to stop in which both feet are off the floor and the hips fall freely.

    A flight that the track's start or end cuts off may be half as long as a whole one.
    """
    rate_hz, flights = points.frame_rate_hz, []
    for start, stop in find_runs(np.asarray((points.lowest_m > _FLIGHT_M).all(1))):
        least_s = _FLIGHT_S[0] / (1.0 if start and stop < points.num_frames else 2.0)
        if least_s <= (stop - start) / rate_hz <= _FLIGHT_S[1] and _falls(points.centre_m[start:stop, 2], rate_hz):
            flights.append((start, stop))
    return flights


def _jumps(points: BodyPoints, standing_z_m: float) -> list[BodyMovement]:
    rate_hz = points.frame_rate_hz
    toes_m = points.toes_m[..., 2].mean(1)
    jumps = []
    for start, stop in find_flights(points):
        if start == 0 or stop == points.num_frames:
            continue
        air = min(round(_AIR_S * rate_hz), round(_AIR_SHARE * (stop - start)))
        takeoff = _corner(toes_m, start, air, rate_hz, is_takeoff=True)
        landing = _corner(toes_m, stop, air, rate_hz, is_takeoff=False)
        top_m = _top_m(points.centre_m[start:stop, 2]) - standing_z_m
        if takeoff is None or landing is None or top_m < _LEAST_JUMP_M:
            continue
        flight_s = (landing.row - takeoff.row) / rate_hz
        height_m = _GRAVITY_M_S2 * flight_s**2 / 8
        sigma_s = float(np.hypot(takeoff.sigma_rows, landing.sigma_rows)) / rate_hz
        # Both heights agree of a body that lands as it takes off, but for the rise on the toes (up to 0.15 m).
        agrees = np.exp(-0.5 * ((height_m - top_m) / 0.15) ** 2)
        sure = 1.0 / (1.0 + (_GRAVITY_M_S2 * flight_s / 4 * sigma_s / 0.03) ** 2)
        measured = float(points.measured[start - 1 : stop + 1].mean())
        # An ankle rises before its foot leaves the floor: it tells no flight time.
        by_flight_m = height_m if points.is_marked.all() else None
        jumps.append(
            BodyMovement(
                "jump", takeoff.row, landing.row, flight_s, float(measured * agrees * sure), by_flight_m, top_m
            )
        )
    return jumps


def _falls(height_m: Float[np.ndarray, " frames"], rate_hz: float) -> bool:
    """Free fall of the hips: the curvature of the parabola through their heights is gravity's."""
    if len(height_m) < 4:
        return False
    time_s = np.arange(len(height_m)) / rate_hz
    share = -2.0 * np.polyfit(time_s - time_s.mean(), height_m, 2)[0] / _GRAVITY_M_S2
    return bool(_FALLING[0] < share < _FALLING[1])


def _corner(
    height_m: Float[np.ndarray, " frames"], row: int, air: int, rate_hz: float, *, is_takeoff: bool
) -> Corner | None:
    """Corner of the feet's height at a take-off or landing near a row; ``air`` frames of the flight are used."""
    on_floor = round(_FLOOR_S * rate_hz)
    before, after = (on_floor, air) if is_takeoff else (air, on_floor)
    first, last = max(row - before, 0), min(row + after + 1, len(height_m))
    if is_takeoff:
        corner = rest_ends(height_m[first:last], rate_hz, has_speed=True)
    else:
        corner = rest_begins(-height_m[first:last], rate_hz, has_speed=True)
    return None if corner is None else corner._replace(row=first + corner.row)


def _top_m(height_m: Float[np.ndarray, " frames"]) -> float:
    """Highest point of a flight, from a parabola through its heights: it lies between frames, and noise is averaged."""
    rows = np.arange(len(height_m), dtype=float)
    top = int(height_m.argmax())
    near = slice(max(top - len(rows) // 4 - 1, 0), top + len(rows) // 4 + 2)
    curve = np.polynomial.Polynomial.fit(rows[near], height_m[near], 2)
    turn = curve.deriv().roots()
    if len(turn) == 1 and rows[near][0] <= turn[0].real <= rows[near][-1]:
        return float(curve(turn[0].real))
    return float(height_m.max())


def _dips(
    points: BodyPoints, height_m: Float[np.ndarray, " frames"], standing_m: float, jumps: Sequence[BodyMovement]
) -> list[BodyMovement]:
    rate_hz = points.frame_rate_hz
    seated = _seated(points, height_m)
    movements: list[BodyMovement] = []
    for start, stop in find_runs(height_m < _BEGINS * standing_m):
        rows = slice(start, stop)
        if height_m[rows].min() > _DEEP * standing_m or not _feet_stay(points, rows):
            continue
        depth_m = float(standing_m - height_m[rows].min())
        measured = float(points.measured[rows].mean())
        rests = [run for run in find_runs(seated[rows]) if run[1] - run[0] >= _SEATED_S * rate_hz]
        if rests:
            down, up = start + rests[0][0], start + rests[-1][1]
            if start > 0:
                movements.append(
                    BodyMovement(
                        "stand_to_sit", float(start), float(down), (down - start) / rate_hz, measured, depth_m=depth_m
                    )
                )
            if stop < points.num_frames:
                movements.append(
                    BodyMovement(
                        "sit_to_stand", float(up), float(stop), (stop - up) / rate_hz, measured, depth_m=depth_m
                    )
                )
            continue
        is_whole = start > 0 and stop < points.num_frames
        lasts = _SQUAT_S[0] <= (stop - start) / rate_hz <= _SQUAT_S[1]
        if is_whole and lasts and not _is_of_jump(start, stop, jumps, rate_hz):
            movements.append(
                BodyMovement("squat", float(start), float(stop), (stop - start) / rate_hz, measured, depth_m=depth_m)
            )
    return movements


def _is_of_jump(start: int, stop: int, jumps: Sequence[BodyMovement], rate_hz: float) -> bool:
    """Return whether a dip leads to a take-off, or absorbs a landing."""
    near = _OF_JUMP_S * rate_hz
    return any(abs(jump.start_row - stop) < near or abs(start - jump.end_row) < near for jump in jumps)


def _feet_stay(points: BodyPoints, rows: slice) -> bool:
    ways_m = np.ptp(points.ankles_m[rows, :, :2], axis=0)
    low = np.median(points.lowest_m[rows]) < 2 * _FLIGHT_M
    return bool((np.linalg.norm(ways_m, axis=-1) < _FOOT_STAYS_M).all() and low)


def _seated(points: BodyPoints, height_m: Float[np.ndarray, " frames"]) -> Bool[np.ndarray, " frames"]:
    """Frames in which the hips rest, and the centre of mass is behind the heels: only a seat holds it there."""
    across_m = points.hips_m[:, 0, :2] - points.hips_m[:, 1, :2]
    ahead = np.column_stack([across_m[:, 1], -across_m[:, 0]])
    ahead /= np.maximum(np.linalg.norm(ahead, axis=-1, keepdims=True), 1e-9)
    behind_m = ((points.heels_m.mean(1)[:, :2] - points.mass_m[:, :2]) * ahead).sum(-1)
    hips_m = gaussian_filter1d(points.centre_m, _SMOOTH_S * points.frame_rate_hz, axis=0, mode="nearest")
    speed = np.linalg.norm(np.gradient(hips_m, axis=0), axis=-1) * points.frame_rate_hz
    return np.asarray((behind_m > _BEHIND_M) & (speed < _RESTING_M_S))
