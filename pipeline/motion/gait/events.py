"""Foot strikes and foot offs, from the motion of heels and toes on the ground.

Swings are found first: a foot that moves on the ground by a step, faster than it does in a stance (the foot velocity
algorithm of O'Connor et al. 2007, doi:10.1016/j.gaitpost.2006.05.016, on the ground in place of the vertical). Each
swing has a foot off before it and a foot strike after it. Their instants are corners: the toe is at rest until the foot
off and then moves ahead with a growing speed; the heel comes to rest at the foot strike. Extremes of the distance from
heel to hips (Zeni et al. 2008, doi:10.1016/j.gaitpost.2007.07.007) bound the search: the heel is farthest ahead of the
hips shortly before the strike, the toe farthest behind shortly before the foot off.
"""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from pipeline.core.data.animation import Side
from pipeline.motion.gait.points import BodyPoints
from pipeline.motion.skeleton.feet.floor import SIDES, find_runs, speed_m_s

# Steps between tried instants, as a share of a frame.
_STEP = 0.05
# Noise lasts over frames: so many frames count as one independent measurement.
_FRAMES_PER_MEASUREMENT = 3.0
# Smallest noise of a position, which the precision of numbers and of the model leaves.
_LEAST_NOISE_M = 5e-4


class Corner(NamedTuple):
    """Instant at which a point's rest begins or ends."""

    row: float  # Row of the path, with its fraction
    sigma_rows: float  # Standard deviation of the row
    speed_m_s: float  # Speed with which the point arrives or leaves, of the model


def rest_ends(path_m: Float[np.ndarray, " frames"], frame_rate_hz: float, *, has_speed: bool) -> Corner | None:
    """Fit the end of a rest: constant until an instant t0, then ``a (t - t0)^2 + c (t - t0)^3``.

    A point that may leave with a speed has ``b (t - t0)`` in place of the cubic term. Least squares over the whole
    path, with t0 tried in steps of a twentieth of a frame: the instant lies between
    frames where the data allow. The standard deviation is of t0 in the linearised problem, from the residuals.

    ``path_m``: positions along one direction, at rest at the start and moving to larger values at the end.
    ``has_speed``: whether the point may leave with a speed, as in a jump; otherwise it only accelerates, as a toe that
    leaves the floor in gait. Returns corner; ``None`` for paths of fewer than six frames, or if the point never moves.
    """
    num_frames = len(path_m)
    if num_frames < 6:
        return None
    rows = np.arange(num_frames, dtype=float)
    tried = np.arange(1.0, num_frames - 3.0, _STEP)
    since_s = np.maximum(rows - tried[:, None], 0.0) / frame_rate_hz
    columns = [np.ones_like(since_s), since_s**2, since_s if has_speed else since_s**3]
    design = np.stack(columns, axis=-1)
    transposed = design.swapaxes(1, 2)
    normal = transposed @ design + 1e-12 * np.eye(design.shape[-1])
    solution = np.linalg.solve(normal, transposed @ path_m[:, None])
    residual_m = path_m - (design @ solution)[..., 0]
    error = (residual_m**2).sum(-1)
    growing = solution[:, 1, 0] > 0 if not has_speed else solution[:, 2, 0] > 0
    if not growing.any():
        return None
    best = int(np.where(growing, error, np.inf).argmin())
    acceleration = solution[best, 1, 0]
    speed, jerk = (solution[best, 2, 0], 0.0) if has_speed else (0.0, solution[best, 2, 0])
    moved_s = since_s[best]
    by_instant = -np.where(moved_s > 0, speed + 2 * acceleration * moved_s + 3 * jerk * moved_s**2, 0.0)
    jacobian = np.column_stack([design[best], by_instant])
    noise = max(float(np.sqrt(error[best] / max(num_frames - jacobian.shape[1], 1))), _LEAST_NOISE_M)
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * noise**2 * _FRAMES_PER_MEASUREMENT
    sigma_rows = float(np.sqrt(max(covariance[-1, -1], 0.0))) * frame_rate_hz
    return Corner(float(tried[best]), sigma_rows, float(speed))


def rest_begins(path_m: Float[np.ndarray, " frames"], frame_rate_hz: float, *, has_speed: bool) -> Corner | None:
    """Fit the start of a rest: ``rest_ends`` of the path backwards.

    ``path_m`` moves to larger values at first, and is at rest at the end.
    """
    corner = rest_ends(-(path_m[::-1] - path_m[-1]), frame_rate_hz, has_speed=has_speed)
    return None if corner is None else corner._replace(row=len(path_m) - 1 - corner.row)


EventKind = Literal["foot_strike", "foot_off"]

_HORIZONTAL = np.array([1.0, 1.0, 0.0])
# Least speed and way of a swinging foot.
_SWING_M_S, _SWING_M = 0.35, 0.15
# A swing's speed exceeds this share of its maximum between the bounds of its middle.
_FAST = 0.5
# Time at rest, and share of the swing's way, that the fit of a corner covers.
_REST_S, _WAY = 0.15, 0.5
# Standard deviation that the model of a corner leaves, and of an ankle in place of heel and toe.
_MODEL_S, _ANKLE_S = 0.006, 0.02
# Tolerance of an event within which its confidence is the probability that it lies.
_TOLERANCE_S = 1.0 / 30.0
# Time around an event in which its foot should be measured, and share of this time in which it must be known.
_AROUND_S, _KNOWN_SHARE = 0.1, 0.8


@dataclass(frozen=True, slots=True)
class FootEvent:
    """Instant at which a foot touches the ground, or leaves it."""

    kind: EventKind
    side: Side
    row: float  # Row of the track, with its fraction
    uncertainty_s: float  # Standard deviation of the instant
    confidence: float  # Confidence in [0, 1]: share of measured frames times the probability of 1/30 s


@dataclass(frozen=True, slots=True)
class Swing:
    """Swing of a foot from its foot off to its foot strike; an event is ``None`` where the take cuts it off."""

    side: Side
    off: FootEvent | None
    strike: FootEvent | None


def find_swings(points: BodyPoints) -> tuple[Swing, ...]:
    """Find the swings of both feet with their events, in order of their middles."""
    swings = [found for foot, side in enumerate(SIDES) for found in _foot_swings(points, foot, side)]
    return tuple(swing for _, swing in sorted(swings, key=lambda item: item[0]))


def _foot_swings(points: BodyPoints, foot: int, side: Side) -> list[tuple[float, Swing]]:
    rate_hz = points.frame_rate_hz
    heel_m, toe_m = (marks_m[:, foot] * _HORIZONTAL for marks_m in (points.heels_m, points.toes_m))
    if points.num_frames < 6:
        return []
    middle_m = (heel_m + toe_m) / 2
    speed = speed_m_s(middle_m, rate_hz)
    found = []
    runs = find_runs(speed > _SWING_M_S)
    for number, (start, stop) in enumerate(runs):
        way_m = middle_m[min(stop, len(middle_m) - 1)] - middle_m[max(start - 1, 0)]
        length_m = float(np.linalg.norm(way_m))
        if length_m < _SWING_M:
            continue
        ahead = way_m / length_m
        before = runs[number - 1][1] if number else 0
        after = runs[number + 1][0] if number + 1 < len(runs) else points.num_frames
        rows = slice(before, after)  # from the swing before to the one after
        fast = start + np.flatnonzero(speed[start:stop] >= _FAST * speed[start:stop].max())
        off = strike = None
        if start > 0:
            off = _foot_off(toe_m[rows] @ ahead, start - before, int(fast[0]) - before, length_m, rate_hz)
        if stop < points.num_frames:
            strike = _foot_strike(heel_m[rows] @ ahead, int(fast[-1]) - before, stop - before, length_m, rate_hz)
        found.append(
            (
                (start + stop) / 2,
                Swing(
                    side,
                    _event("foot_off", points, foot, before, off),
                    _event("foot_strike", points, foot, before, strike),
                ),
            )
        )
    return found


def _foot_off(
    along_m: Float[np.ndarray, " rows"], start: int, fast: int, length_m: float, rate_hz: float
) -> Corner | None:
    """End of the toe's rest in a window from the stance to the first part of the swing."""
    rest = np.median(along_m[max(0, start - round(2 * _REST_S * rate_hz)) : start + 1])
    gone = np.flatnonzero(along_m[start:] - rest > _WAY * length_m)
    stop = min(start + int(gone[0]) if len(gone) else fast, len(along_m) - 1) + 1
    first = max(0, start - round(_REST_S * rate_hz))
    corner = rest_ends(along_m[first:stop], rate_hz, has_speed=False)
    return None if corner is None else corner._replace(row=first + corner.row)


def _foot_strike(
    along_m: Float[np.ndarray, " rows"], fast: int, stop: int, length_m: float, rate_hz: float
) -> Corner | None:
    """Start of the heel's rest in a window from the last part of the swing to the stance."""
    rest = np.median(along_m[stop - 1 : stop + round(2 * _REST_S * rate_hz)])
    coming = np.flatnonzero(rest - along_m[:stop] > _WAY * length_m)
    first = int(coming[-1]) if len(coming) else fast
    last = stop + round(_REST_S * rate_hz)
    corner = rest_begins(along_m[first:last], rate_hz, has_speed=False)
    return None if corner is None else corner._replace(row=first + corner.row)


def _event(kind: EventKind, points: BodyPoints, foot: int, first_row: int, corner: Corner | None) -> FootEvent | None:
    """Event at a corner, whose row counts from ``first_row``; ``None`` where the foot is not known around it."""
    if corner is None:
        return None
    rate_hz, row = points.frame_rate_hz, first_row + corner.row
    around = _AROUND_S * rate_hz
    rows = slice(max(int(row - around), 0), int(row + around) + 2)
    if points.known[rows, foot].mean() < _KNOWN_SHARE:
        return None
    ankle_s = 0.0 if points.is_marked[foot] else _ANKLE_S
    sigma_s = float(np.sqrt((corner.sigma_rows / rate_hz) ** 2 + _MODEL_S**2 + ankle_s**2))
    likely = float(_normal_within(_TOLERANCE_S / sigma_s))
    return FootEvent(kind, SIDES[foot], row, sigma_s, float(points.measured[rows, foot].mean()) * likely)


def _normal_within(z: float) -> float:
    """Probability that a normal variable is within some standard deviations."""
    return math.erf(z / math.sqrt(2.0))
