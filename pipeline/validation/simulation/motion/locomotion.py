"""Locomotion: routes of people on the floor, and steps of their feet.

A route counts steps. The count is a whole number when a person stands: both feet are on the floor then. A foot lands
where the body will be in the middle of the foot's stance, or where the walk ends, and stays there until it is lifted.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter1d

from pipeline.validation.simulation.motion.body import Proportions, turned
from pipeline.validation.simulation.motion.script import Away, Cue, Role, Stay, Turn, Walk

GRID_HZ = 200.0
"""Rate of the grid of motion; positions between rows are interpolated linearly."""

# Share of a stride (two steps) for which a foot stands, in walking and in running; in the middle the body is above the
# foot. In running the share is less than half, with both feet off the floor in between.
_STANCE_WALKING, _STANCE_RUNNING = 0.6, 0.35
# Speeds at which walking starts to change into running, and at which it is running.
_RUN_FROM_M_S, _RUN_M_S = 2.2, 2.7
# The body starts to move when the first foot swings, and stops before the last step ends; in steps.
_OPENING_STEPS = 0.6
_CLOSING_STEPS = 0.4
_RAMP_S = 0.6
_TURN_RAD_S = 2.2
_LARGEST_CURVE_RAD = 1.0
_LIFT_WALKING_M, _LIFT_RUNNING_M = 0.09, 0.22
# The heel rises before the foot swings.
_HEEL_SHARE = 0.1
_CHANGE_OF_GAIT_S = 0.1
_SMOOTH_S = 0.1


@dataclass(frozen=True, slots=True)
class Stance:
    """Position and heading of a standing person, and the number of steps so far."""

    xy_m: tuple[float, float]
    yaw_rad: float
    steps: float


@dataclass(frozen=True, slots=True, eq=False)
class Route:
    """Route of a person on the grid of ``GRID_HZ``."""

    # Position and heading of the hips
    xy_m: Float[np.ndarray, "times 2"]
    yaw_rad: Float[np.ndarray, " times"]
    steps: Float[np.ndarray, " times"]  # Number of steps so far
    present: Bool[np.ndarray, " times"]  # True if the person is present

    @property
    def end(self) -> Stance:
        """Stance at the end of the route."""
        return Stance((float(self.xy_m[-1, 0]), float(self.xy_m[-1, 1])), float(self.yaw_rad[-1]), self.steps[-1])


def smoothstep(x: np.ndarray) -> np.ndarray:
    """Smoothstep function ``3 x^2 - 2 x^3``, 0 for x below 0 and 1 for x above 1."""
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3 - 2 * x)


def follow(cue: Cue, start: Stance) -> tuple[Route, ...]:
    """Lay out the routes of a cue, each from rest to rest."""
    match cue:
        case Stay(duration_s=duration_s):
            return (_rest(start, duration_s),)
        case Turn(facing_rad=facing_rad):
            return (_turn(start, facing_rad),)
        case Away(duration_s=duration_s, to_m=to_m, facing_rad=facing_rad):
            # Two unseen steps let the feet land at the new place.
            leaving = _on_the_spot(start, duration_s / 2)
            arriving = _on_the_spot(Stance(to_m, facing_rad, leaving.steps[-1]), duration_s / 2)
            return leaving, arriving
        case Walk(to_m=to_m, speed_m_s=speed_m_s):
            ahead = np.subtract(to_m, start.xy_m)
            angle = _shorter_way(float(np.arctan2(ahead[1], ahead[0])) - start.yaw_rad)
            if abs(angle) <= _LARGEST_CURVE_RAD:
                return (_walk(start, to_m, speed_m_s),)
            turning = _turn(start, start.yaw_rad + angle)
            return turning, _walk(turning.end, to_m, speed_m_s)


def lay_out(role: Role, duration_s: float) -> tuple[Route, Float[np.ndarray, " rests"], list[slice]]:
    """Lay out the route of a whole role, from time 0 on.

    Returns the smoothed route, numbers of steps at which the person comes to rest, and rows of each cue.
    """
    num_rows = round(duration_s * GRID_HZ) + 1
    stance = Stance(role.start_m, role.facing_rad, 0.0)
    routes = [_rest(stance, 1 / GRID_HZ)]
    borders = [1]
    for cue in role.cues:
        routes += follow(cue, routes[-1].end)
        borders.append(sum(len(route.steps) for route in routes))
    if borders[-1] < num_rows:
        routes.append(_rest(routes[-1].end, (num_rows - borders[-1]) / GRID_HZ))
    rests = np.unique([route.steps[-1] for route in routes])
    xy_m, yaw_rad, steps = (
        np.concatenate([getattr(route, name) for route in routes])[:num_rows] for name in ("xy_m", "yaw_rad", "steps")
    )
    present = np.concatenate([route.present for route in routes])[:num_rows]
    sigma = _SMOOTH_S * GRID_HZ
    smooth = Route(
        gaussian_filter1d(xy_m, sigma, axis=0, mode="nearest"),
        gaussian_filter1d(np.unwrap(yaw_rad), sigma, mode="nearest"),
        steps,
        present,
    )
    return smooth, rests, [slice(*rows) for rows in pairwise(borders)]


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """Steps of one foot."""

    share: Float[np.ndarray, " times"]  # Share of the stride since the foot landed, from 0 to 1
    stance: Float[np.ndarray, " times"]  # Share of the stride for which the foot stands
    run: Float[np.ndarray, " times"]  # Share of running in the gait, from 0 (walking) to 1 (running)
    xy_m: Float[np.ndarray, "times 2"]  # Position of the level foot's ankle on the floor
    # Heading of the body at the footprint, blended from one footprint to the next while the foot swings
    yaw_rad: Float[np.ndarray, " times"]


def follow_steps(route: Route, rests: Float[np.ndarray, " rests"], body: Proportions) -> tuple[Steps, Steps]:
    """Steps of the left and of the right foot on a route."""
    left, right = (_steps(route, rests, body, side) for side in (0, 1))
    return left, right


def ankles(steps: tuple[Steps, Steps], body: Proportions) -> Float[np.ndarray, "times 2 3"]:
    """Positions of the left and the right ankle of feet whose joints are not simulated."""
    return np.stack([_ankle(of_foot, body) for of_foot in steps], axis=1)


def lift_m(run: Float[np.ndarray, " times"]) -> Float[np.ndarray, " times"]:
    """Largest height of a swinging foot's ankle above the standing foot's ankle."""
    return _LIFT_WALKING_M + run * (_LIFT_RUNNING_M - _LIFT_WALKING_M)


def _ankle(steps: Steps, body: Proportions) -> Float[np.ndarray, "times 3"]:
    rising = np.clip((steps.share - steps.stance + _HEEL_SHARE) / (1 - steps.stance + _HEEL_SHARE), 0.0, 1.0)
    height_m = body.ankle_height_m + lift_m(steps.run) * np.sin(np.pi * rising) ** 2
    return np.column_stack([steps.xy_m, height_m])


def _steps(route: Route, rests: Float[np.ndarray, " rests"], body: Proportions, side: int) -> Steps:
    # The right foot is half a stride, one step, behind the left foot.
    strides = route.steps / 2 + side / 2
    number = np.floor(strides).astype(int)
    share = strides - number
    numbers = np.arange(number.min(), number.max() + 2)
    landing_steps = 2 * (numbers - side / 2)
    rest = rests[np.minimum(np.searchsorted(rests, landing_steps - 1e-6), len(rests) - 1)]
    run = _running(route)
    stance = _STANCE_WALKING + run * (_STANCE_RUNNING - _STANCE_WALKING)
    # The body is above the foot in the middle of the foot's next stance.
    landing_stance = np.interp(landing_steps, route.steps, stance)
    middle_steps = np.minimum(landing_steps + landing_stance, rest)
    row = np.interp(middle_steps, route.steps, np.arange(len(route.steps)))
    footprint_m = _beside(route, row, body.hip_width_m * (0.5 - side))
    heading_rad = np.interp(row, np.arange(len(route.steps)), route.yaw_rad)
    here, following = number - numbers[0], number - numbers[0] + 1
    moved = smoothstep((share - stance) / (1 - stance))
    return Steps(
        share,
        stance,
        run,
        footprint_m[here] + moved[:, None] * (footprint_m[following] - footprint_m[here]),
        heading_rad[here] + moved * (heading_rad[following] - heading_rad[here]),
    )


def _running(route: Route) -> Float[np.ndarray, " times"]:
    """Share of running in the gait, from 0 (walking) to 1 (running)."""
    speed_m_s = np.linalg.norm(np.gradient(route.xy_m, axis=0), axis=-1) * GRID_HZ
    run = smoothstep((speed_m_s - _RUN_FROM_M_S) / (_RUN_M_S - _RUN_FROM_M_S))
    return np.asarray(gaussian_filter1d(run, _CHANGE_OF_GAIT_S * GRID_HZ, mode="nearest"))


def _beside(route: Route, row: Float[np.ndarray, " rows"], left_m: float) -> Float[np.ndarray, "rows 2"]:
    """Points to the left of the route at fractional rows."""
    rows = np.arange(len(route.steps))
    x, y, yaw = (np.interp(row, rows, values) for values in (*route.xy_m.T, route.yaw_rad))
    return np.column_stack([x, y]) + left_m * turned(yaw, np.zeros_like(yaw))[:, :2, 1]


def _shorter_way(angle_rad: float) -> float:
    return (angle_rad + np.pi) % (2 * np.pi) - np.pi


def _constant(start: Stance, num_rows: int) -> tuple[np.ndarray, np.ndarray]:
    return np.tile(np.asarray(start.xy_m, float), (num_rows, 1)), np.full(num_rows, start.yaw_rad)


def _num_rows(duration_s: float) -> int:
    return max(1, round(duration_s * GRID_HZ))


def _rest(start: Stance, duration_s: float) -> Route:
    num_rows = _num_rows(duration_s)
    return Route(*_constant(start, num_rows), np.full(num_rows, start.steps), np.ones(num_rows, dtype=bool))


def _on_the_spot(start: Stance, duration_s: float) -> Route:
    """Two unseen steps on the spot."""
    num_rows = _num_rows(duration_s)
    steps = start.steps + 2 * np.arange(1, num_rows + 1) / num_rows
    return Route(*_constant(start, num_rows), steps, np.zeros(num_rows, dtype=bool))


def _turn(start: Stance, facing_rad: float) -> Route:
    angle = _shorter_way(facing_rad - start.yaw_rad)
    num_rows = _num_rows(0.5 + abs(angle) / _TURN_RAD_S)
    done = smoothstep(np.arange(1, num_rows + 1) / num_rows)
    xy_m, yaw_rad = _constant(start, num_rows)
    return Route(xy_m, yaw_rad + angle * done, start.steps + 2 * done, np.ones(num_rows, dtype=bool))


def _walk(start: Stance, to_m: Sequence[float], speed_m_s: float) -> Route:
    """Walk along a cubic Hermite curve, with a smooth start and stop."""
    begin, target = np.asarray(start.xy_m, float), np.asarray(to_m, float)
    chord = target - begin
    ahead = np.linalg.norm(chord) * np.array([np.cos(start.yaw_rad), np.sin(start.yaw_rad)])
    u = np.linspace(0, 1, 201)[:, None]
    curve_m = (
        (1 - u) ** 2 * (1 + 2 * u) * begin
        + u * (1 - u) ** 2 * ahead
        + u**2 * (3 - 2 * u) * target
        - u**2 * (1 - u) * chord
    )
    length_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve_m, axis=0), axis=1))])
    tangent = np.gradient(curve_m, axis=0)
    heading = np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))

    # Faster people take longer steps (0.67 m at 1.3 m/s).
    num_steps = 1 + max(1, round(length_m[-1] / (0.35 + 0.25 * speed_m_s)))
    num_rows = _num_rows(length_m[-1] / speed_m_s + _RAMP_S)
    time_s = np.arange(1, num_rows + 1) / GRID_HZ
    speed = np.minimum(smoothstep(time_s / _RAMP_S), smoothstep((num_rows / GRID_HZ - time_s) / _RAMP_S) + 1e-3)
    steps = np.round(num_steps * np.cumsum(speed) / speed.sum(), 9)
    way_m = length_m[-1] * np.clip((steps - _OPENING_STEPS) / (num_steps - _OPENING_STEPS - _CLOSING_STEPS), 0.0, 1.0)
    xy_m = np.column_stack([np.interp(way_m, length_m, axis) for axis in curve_m.T])
    yaw_rad = start.yaw_rad + np.interp(way_m, length_m, heading) - heading[0]
    return Route(xy_m, yaw_rad, start.steps + steps, np.ones(num_rows, dtype=bool))
