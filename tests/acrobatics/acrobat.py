"""Performance of acrobatics: random bodies, and motions in which planted points stay and nothing is below the floor."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from pipeline.core.joints import BODY_FEET, COCO_17, FINGER_JOINTS, SIDES, JointSet
from pipeline.motion.body_segments import SEGMENTS, WORLD
from pipeline.validation.simulation.motion.body import random_proportions
from pipeline.validation.simulation.motion.feet import random_foot_shape
from pipeline.validation.simulation.motion.hands import Hands, finger_motion, fingers, random_scale
from pipeline.validation.simulation.motion.locomotion import GRID_HZ, smoothstep
from tests.acrobatics import anatomy
from tests.acrobatics.key_poses import KeyPose, ReferenceMotion, reference_motion, vary

# Time before and after a point is planted in which it moves to and from its place.
_EASE_S = 0.2
# Deviations from the reference motion: of the hips and of angles.
_ROOT_M, _ANGLE_RAD = 0.10, 0.25
# Deviations of planted points and of depths below the floor, by step. They begin wide, so that limbs that are bent or
# stretched as far as they go are not torn. And shares of a step of which the best one is taken.
_HELD_M = (0.05, 0.02, 0.01, 0.005, 0.002, 0.001, 0.001, 0.001)
_SHARES = np.array([0.0, 0.1, 0.3, 0.6, 1.0])
_NUM_PASSES = 3
_DIFFERENCE = 1e-5
_AT_LIMIT = 1e12
# Time over which the changes by planted points and the floor are smoothed between passes, and all movement at the end.
_SPREAD_S, _SOFT_S = 0.1, 0.03
# Rate at which the motion is solved; cubic splines connect its rows.
_SOLVED_HZ = 40.0
# Random movement of all angles.
_SWAY_S, _SWAY_RAD = 0.5, 0.02
# Height and speed up to which a mark of a foot stands on the floor.
_ON_FLOOR_M, _STILL_M_S = 0.015, 0.10
_LIMITS_RAD = np.radians([*anatomy.ANGLE_LIMITS_DEG.values()]).T
_PAIRS = [COCO_17.indices((f"left_{joint}", f"right_{joint}")) for joint in ("shoulder", "elbow", "wrist")]


@dataclass(frozen=True, slots=True, eq=False)
class Acrobat:
    """Body and motion of an acrobat from time 0 on."""

    body: anatomy.AcrobatBody
    motion: CubicSpline  # Centre of the hips (metres), then angles of ``anatomy.ANGLE_NAMES`` (radians), over time
    hands: Hands  # Fingers, which rest, on the grid of ``GRID_HZ``


def perform_acrobatics(
    keys: Sequence[KeyPose],
    center_m: tuple[float, float],
    facing_rad: float,
    duration_s: float,
    rng: np.random.Generator,
) -> Acrobat:
    """Draw a body and its variation of the key poses, and compute the motion.

    ``center_m`` is the middle of the way of the hips, and ``facing_rad`` the heading of a pelvis that is not turned.
    Planted points stay in place within a few millimetres, and no point sinks into the floor by more than 2 cm.
    """
    proportions = random_proportions(rng)
    body = anatomy.AcrobatBody(proportions, random_foot_shape(proportions, rng))
    time_s = np.arange(np.ceil(duration_s * _SOLVED_HZ) + 2) / _SOLVED_HZ
    reference = reference_motion(vary(keys, rng), body, center_m, facing_rad, time_s)
    sway = gaussian_filter1d(rng.normal(size=reference.angles_rad.shape), _SWAY_S * _SOLVED_HZ, axis=0, mode="nearest")
    sway *= _SWAY_RAD / max(float(sway.std()), 1e-9)
    state = _plant(replace(reference, angles_rad=reference.angles_rad + sway), body, time_s)
    fingers_rad = finger_motion((), (), round(duration_s * GRID_HZ) + 1, rng)
    return Acrobat(body, CubicSpline(time_s, state), Hands(random_scale(proportions, rng), fingers_rad))


def acrobat_joints_at(
    acrobat: Acrobat, time_s: Float[np.ndarray, " times"], joints: JointSet
) -> Float[np.ndarray, "times joints 3"]:
    """World positions in metres of joints of ``COCO_17``, ``BODY_FEET`` or ``WHOLE_BODY``."""
    state = acrobat.motion(np.clip(time_s, 0.0, acrobat.motion.x[-1]))
    body_m = anatomy.points_m(acrobat.body, state[:, :3], state[:, 3:])
    num_marks = len(COCO_17.names) if joints == COCO_17 else len(BODY_FEET.names)
    joints_m = body_m[:, :num_marks]
    if not FINGER_JOINTS.isdisjoint(joints.names):
        row = np.clip(np.rint(time_s * GRID_HZ).astype(int), 0, len(acrobat.hands.angles_rad) - 1)
        hands = replace(acrobat.hands, angles_rad=acrobat.hands.angles_rad[row])
        joints_m = np.concatenate([joints_m, fingers(hands, *(body_m[:, pair] for pair in _PAIRS))], axis=1)
    return np.asarray(joints_m)


def acrobat_segments_at(
    acrobat: Acrobat, time_s: Float[np.ndarray, " times"]
) -> dict[str, Float[np.ndarray, "times 3 3"]]:
    """Exact orientations ``world_from_segment`` of the segments of ``motion.angles``, without hands, by name."""
    state = acrobat.motion(np.clip(time_s, 0.0, acrobat.motion.x[-1]))
    return {name: part @ WORLD for name, part in anatomy.body_parts(state[:, 3:]).items() if name in SEGMENTS}


def feet_on_floor(
    body_feet_m: Float[np.ndarray, "frames 21 3"], frame_rate_hz: float
) -> Bool[np.ndarray, "frames 2 3"]:
    """True contacts of feet (left, right) by part (heel, toe, instep): where a part lies still on the floor.

    ``body_feet_m`` are true joints of ``BODY_FEET`` in metres. The instep is on the floor where the ankle is as low as
    it can be.
    """
    marks = np.array([[BODY_FEET.index(f"{side}_{part}") for part in ("heel", "big_toe", "ankle")] for side in SIDES])
    parts_m = body_feet_m[:, marks]
    speed_m_s = np.linalg.norm(np.gradient(parts_m, axis=0), axis=-1) * frame_rate_hz
    return np.asarray((parts_m[..., 2] < anatomy.CLEARANCE_M[marks] + _ON_FLOOR_M) & (speed_m_s < _STILL_M_S))


def _plant(
    reference: ReferenceMotion, body: anatomy.AcrobatBody, time_s: Float[np.ndarray, " times"]
) -> Float[np.ndarray, "times values"]:
    """Hips and angles near a reference motion that keep planted points in place and all points above the floor.

    A point that is planted moves the whole body. So that the body does so smoothly, the changes of each pass are
    smoothed over time, and the next pass starts from them.
    """
    first = np.concatenate([reference.root_m, np.clip(reference.angles_rad, *_LIMITS_RAD)], axis=1)
    points = sorted({anatomy.POINTS.index(run.point) for run in reference.planted})
    state = first
    for number in range(_NUM_PASSES):
        start = first
        if number:
            start = first + gaussian_filter1d(state - first, _SPREAD_S * _SOLVED_HZ, axis=0, mode="nearest")
        target_m = _targets_m(reference, anatomy.points_m(body, start[:, :3], start[:, 3:]), points, time_s)
        state = _solve_near(start, target_m, points, body)
    # Flesh and tendons soften the moment in which a point touches the floor.
    return gaussian_filter1d(state, _SOFT_S * _SOLVED_HZ, axis=0, mode="nearest")


def _solve_near(
    start: Float[np.ndarray, "times values"],
    target_m: Float[np.ndarray, "times planted 3"],
    points: list[int],
    body: anatomy.AcrobatBody,
) -> Float[np.ndarray, "times values"]:
    """Hips and angles closest to the start, with planted points at their targets (Gauss-Newton method)."""
    usual = np.array([*[_ROOT_M] * 3, *[_ANGLE_RAD] * len(anatomy.ANGLE_NAMES)])
    lowest, highest = (
        np.append(np.full(3, free), limit) for free, limit in zip((-np.inf, np.inf), _LIMITS_RAD, strict=True)
    )
    state = start.copy()
    for held_m in _HELD_M:
        residual = _residual(anatomy.points_m(body, state[:, :3], state[:, 3:]), target_m, points)
        moved = (state[:, None] + _DIFFERENCE * np.eye(state.shape[1])).reshape(-1, state.shape[1])
        moved_m = anatomy.points_m(body, moved[:, :3], moved[:, 3:]).reshape(*state.shape, -1, 3)
        beside = np.stack([_residual(moved_m[:, k], target_m, points) for k in range(state.shape[1])], axis=-1)
        jacobian = (beside - residual[..., None]) / _DIFFERENCE
        transposed = jacobian.transpose(0, 2, 1)
        force = -(transposed @ residual[..., None])[..., 0] / held_m**2 - (state - start) / usual**2
        normal = transposed @ jacobian / held_m**2 + np.diag(usual**-2)
        # An angle at its limit stays there while it is pulled beyond.
        at_limit = ((state <= lowest) & (force < 0)) | ((state >= highest) & (force > 0))
        normal += _AT_LIMIT * at_limit[:, None] * np.eye(state.shape[1])
        step = np.linalg.solve(normal, force[..., None])[..., 0]
        tried = np.clip(state + _SHARES[:, None, None] * step, lowest, highest)
        away = ((tried - start) ** 2 / usual**2).sum(-1)
        lost = [(_residual(anatomy.points_m(body, k[:, :3], k[:, 3:]), target_m, points) ** 2).sum(-1) for k in tried]
        state = tried[(np.array(lost) / held_m**2 + away).argmin(0), np.arange(len(state))]
    return state


def _residual(
    here_m: Float[np.ndarray, "times points 3"], target_m: Float[np.ndarray, "times planted 3"], points: list[int]
) -> Float[np.ndarray, "times residuals"]:
    """Distances of planted points from their places along each axis, and depths below the floor, in metres."""
    away_m = np.nan_to_num(here_m[:, points] - target_m).reshape(len(here_m), -1)
    return np.concatenate([away_m, np.maximum(anatomy.CLEARANCE_M - here_m[..., 2], 0.0)], axis=1)


def _targets_m(
    reference: ReferenceMotion,
    here_m: Float[np.ndarray, "times points 3"],
    points: list[int],
    time_s: Float[np.ndarray, " times"],
) -> Float[np.ndarray, "times planted 3"]:
    """Positions of planted points, NaN where they are free.

    A point moves from the reference motion to its place, and back, before and after it is planted.
    """
    target_m = np.full((len(time_s), len(points), 3), np.nan)
    for number, point in enumerate(points):
        runs = [run for run in reference.planted if run.point == anatomy.POINTS[point]]
        shares = [
            smoothstep((time_s - run.start_s) / _EASE_S + 1) * smoothstep((run.stop_s - time_s) / _EASE_S + 1)
            for run in runs
        ]
        moved_m = sum(
            share[:, None] * (run.place_m - here_m[:, point]) for run, share in zip(runs, shares, strict=True)
        )
        led = np.max(shares, axis=0) > 0
        target_m[led, number] = (here_m[:, point] + moved_m)[led]
        target_m[:, number, 2] = np.maximum(target_m[:, number, 2], anatomy.CLEARANCE_M[point])
    return target_m
