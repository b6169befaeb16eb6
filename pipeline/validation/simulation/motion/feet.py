"""Feet of simulated people: heels and big toes of feet that roll from the heel to the toes.

A foot is rigid. In walking it lands on its heel, is level in the middle of its stance, and lifts its heel before it
swings. The point on which it rolls stays in place: the heel after the landing, the big toe before the swing. Standing
feet are level. Heel and big toe are points of the sole.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from pipeline.validation.simulation.motion.body import Proportions, turned
from pipeline.validation.simulation.motion.locomotion import GRID_HZ, Route, Steps, lift_m, smoothstep

# Pitch of the foot at its landing (toes up) and before its swing (heel up), in walking and in running.
_LANDING_RAD = np.radians([18.0, 4.0])
_PUSH_RAD = np.radians([32.0, 45.0])
# Shares of the stride: end of the landing, start of the push before the end of the stance, its end after it, and the
# end of the turn to the next landing.
_LEVEL, _PUSH_BEFORE, _PUSH_AFTER, _READY = 0.12, 0.2, 0.02, 0.95
# Height of a swinging foot's lowest point, as a share of the lift.
_CLEARANCE = 0.5
# Speed of a walk with fully rolling feet; people who turn on the spot lift level feet.
_ROLLING_M_S = 0.9
# Toes point down in the air of a jump.
_HANGING_RAD, _HANGING_M = 0.5, 0.12
_SIDES = np.array([1.0, -1.0])


@dataclass(frozen=True, slots=True)
class FootShape:
    """Size of a person's feet."""

    # Distance of the heel behind the ankle, and of the tip of the big toe before it, on the level sole
    heel_m: float
    toe_m: float
    inward_m: float  # Distance of the big toe from the foot's axis to the body's middle
    outward_rad: float  # Angle of the feet outwards from the heading of the body


@dataclass(frozen=True, slots=True, eq=False)
class Feet:
    """Orientation of the feet over time: heading and pitch of the left and of the right foot; heel up is positive."""

    shape: FootShape
    yaw_rad: Float[np.ndarray, "times 2"]
    pitch_rad: Float[np.ndarray, "times 2"]


def random_foot_shape(body: Proportions, rng: np.random.Generator) -> FootShape:
    """Draw feet around 0.135 of stature from heel to big toe, turned outwards by some degrees."""
    size_m = body.stature_m * float(np.clip(rng.normal(1.0, 0.03), 0.92, 1.08))
    return FootShape(
        heel_m=0.030 * size_m,
        toe_m=0.105 * size_m,
        inward_m=0.010 * size_m,
        outward_rad=float(np.radians(rng.uniform(3.0, 12.0))),
    )


def roll(
    steps: tuple[Steps, Steps],
    route: Route,
    hop_m: Float[np.ndarray, " times"],
    body: Proportions,
    shape: FootShape,
) -> tuple[Feet, Float[np.ndarray, "times 2 3"]]:
    """Orientation of rolling feet, and positions of their ankles.

    ``hop_m`` is the height of the lower end of both feet above the floor in a jump.
    """
    speed_m_s = np.linalg.norm(np.gradient(route.xy_m, axis=0), axis=-1) * GRID_HZ
    share = smoothstep(speed_m_s / _ROLLING_M_S)
    hanging_rad = _HANGING_RAD * smoothstep(hop_m / _HANGING_M)
    yaw_rad = np.stack([of_foot.yaw_rad for of_foot in steps], axis=-1) + _SIDES * shape.outward_rad
    pitch_rad = np.stack([share * _pitch_rad(of_foot) + hanging_rad for of_foot in steps], axis=-1)
    ankles_m = [
        _ankle_m(of_foot, yaw_rad[:, foot], pitch_rad[:, foot], body, shape) for foot, of_foot in enumerate(steps)
    ]
    return Feet(shape, yaw_rad, pitch_rad), np.stack(ankles_m, axis=1) + hop_m[:, None, None] * np.array(
        [0.0, 0.0, 1.0]
    )


def heels_and_toes(
    feet: Feet, ankles_m: Float[np.ndarray, "times 2 3"], body: Proportions
) -> Float[np.ndarray, "times 4 3"]:
    """World positions of left heel, right heel, left big toe and right big toe, as in ``BODY_FEET``."""
    marks_m = []
    for along_m, inward_m in ((-feet.shape.heel_m, 0.0), (feet.shape.toe_m, feet.shape.inward_m)):
        for foot, side in enumerate(_SIDES):
            world_from_foot = turned(feet.yaw_rad[:, foot], feet.pitch_rad[:, foot])
            offset_m = np.array([along_m, -side * inward_m, -body.ankle_height_m])
            marks_m.append(ankles_m[:, foot] + world_from_foot @ offset_m)
    return np.stack(marks_m, axis=1)


def _pitch_rad(steps: Steps) -> Float[np.ndarray, " times"]:
    """Pitch of a foot in full gait: toes up at the landing, level, heel up in the push, toes up again in the swing."""
    landing_rad, push_rad = (
        walking + steps.run * (running - walking) for walking, running in (_LANDING_RAD, _PUSH_RAD)
    )
    landed = smoothstep(steps.share / _LEVEL)
    pushed = smoothstep((steps.share - steps.stance + _PUSH_BEFORE) / (_PUSH_BEFORE + _PUSH_AFTER))
    left = steps.stance + _PUSH_AFTER
    ready = smoothstep((steps.share - left) / (_READY - left))
    return np.asarray(landing_rad * (landed - 1) + push_rad * pushed - (push_rad + landing_rad) * ready)


def _ankle_m(
    steps: Steps,
    yaw_rad: Float[np.ndarray, " times"],
    pitch_rad: Float[np.ndarray, " times"],
    body: Proportions,
    shape: FootShape,
) -> Float[np.ndarray, "times 3"]:
    """Ankle of a foot that rolls on its toes or on its heel, and is clear of the floor in its swing."""
    swung = np.clip((steps.share - steps.stance) / (1 - steps.stance), 0.0, 1.0)
    on_heel = np.where(swung > 0, smoothstep(swung), pitch_rad < 0)[:, None]
    rolled_m = (1 - on_heel) * _rolled_m(shape.toe_m, body.ankle_height_m, pitch_rad)
    rolled_m = rolled_m + on_heel * _rolled_m(-shape.heel_m, body.ankle_height_m, pitch_rad)
    clear_m = _CLEARANCE * lift_m(steps.run) * np.sin(np.pi * swung) ** 2
    ahead = np.stack([np.cos(yaw_rad), np.sin(yaw_rad)], axis=-1)
    xy_m = steps.xy_m + rolled_m[:, :1] * ahead
    return np.column_stack([xy_m, body.ankle_height_m + rolled_m[:, 1] + clear_m])


def _rolled_m(pivot_m: float, height_m: float, pitch_rad: Float[np.ndarray, " times"]) -> Float[np.ndarray, "times 2"]:
    """Displacement of the ankle, ahead and up, if a point of the sole before the ankle stays in place."""
    cos, sin = np.cos(pitch_rad), np.sin(pitch_rad)
    return np.stack([pivot_m * (1 - cos) + height_m * sin, pivot_m * sin - height_m * (1 - cos)], axis=-1)
