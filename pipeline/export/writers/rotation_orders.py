"""Orders of the rotations of joints, chosen so that programs that interpolate angles stay near the motion."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import permutations

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.data.animation import SkeletonMotion
from pipeline.export.presets import Convention
from pipeline.export.writers.blocks import frame_blocks
from pipeline.export.writers.euler import angle_rad, halfway_by_angles, halfway_on_arc
from pipeline.skeleton.model import WHOLE_SKELETON, parents_of

_MM_PER_M = 1000.0
_ORDERS = tuple("".join(axes) for axes in permutations("XYZ"))
# Distance between frames up to which a file keeps the preset's order, and a joint in other files: several add up.
_USUAL_UP_TO_MM, _JOINT_UP_TO_MM = 2.0, 0.25


@dataclass(frozen=True, slots=True)
class BetweenFrames:
    """Place at which interpolated angles are farthest off: programs interpolate each angle of a file linearly."""

    # Largest distance of a joint, half-way between two frames, from its place where rotations take the shortest arcs
    distance_mm: float
    joint: str  # Name in the skeleton of the joint whose angles are off
    frame: int  # Earlier frame of the two, an output frame


@dataclass(frozen=True, slots=True)
class RotationOrders:
    """Orders of the rotations of a person's file."""

    axes: tuple[str, ...]  # Axes of each joint of the skeleton, such as ``ZXY``
    between: BetweenFrames | None  # ``None`` for a single frame


@lru_cache(maxsize=1)  # For the file, and then for what is said about it.
def rotation_orders(motion: SkeletonMotion, convention: Convention) -> RotationOrders:
    """Choose the order of the rotations of each joint.

    The order is the preset's as long as all joints stay within 2 mm half-way between two frames, and where software
    demands it. Interpolated angles are off where the middle one comes near 90 degrees (gimbal lock). Each order has
    this place at other poses, so each joint whose angles are off gets the order with the least error.
    """
    num_joints = len(motion.bone_length_m)
    usual = (convention.rotation_order,) * num_joints
    between = _between_frames(motion, convention, usual)
    if between is None or between.distance_mm <= _USUAL_UP_TO_MM or convention.is_order_demanded:
        return RotationOrders(usual, between)
    choices = (convention.rotation_order, *(axes for axes in _ORDERS if axes != convention.rotation_order))
    off_mm = np.zeros((len(choices), num_joints))
    for _, quat in _overlapping(motion, convention):
        on_arc = halfway_on_arc(quat)
        for axes, worst_mm in zip(choices, off_mm, strict=True):
            angles_off_rad = angle_rad(halfway_by_angles(quat, [axes] * num_joints), on_arc)
            np.maximum(worst_mm, angles_off_rad.max(axis=0) * _reach_mm(motion), out=worst_mm)
    best = np.where(off_mm[0] <= _JOINT_UP_TO_MM, 0, off_mm.argmin(axis=0)).tolist()
    chosen = tuple(choices[number] for number in best)
    better = _between_frames(motion, convention, chosen)
    # Errors of several joints may cancel each other, so that the best orders are worse together.
    if better is None or better.distance_mm >= between.distance_mm:
        return RotationOrders(usual, between)
    return RotationOrders(chosen, better)


def _between_frames(motion: SkeletonMotion, convention: Convention, axes: Sequence[str]) -> BetweenFrames | None:
    """Find where interpolated angles are farthest off with an order of each joint; ``None`` for a single frame."""
    offsets_mm = convention.rest_offsets(motion.bone_length_m) / convention.units_per_m * _MM_PER_M
    farthest: BetweenFrames | None = None
    for start, quat in _overlapping(motion, convention):
        by_angles, on_arc = halfway_by_angles(quat, axes), halfway_on_arc(quat)
        still = np.zeros((len(on_arc), 3))
        places = [chained(still, offsets_mm, matrices(turns)) for turns in (by_angles, on_arc)]
        apart_mm = np.linalg.norm(places[0] - places[1], axis=-1).max(-1)
        row = int(apart_mm.argmax())
        if farthest is None or apart_mm[row] > farthest.distance_mm:
            joint = int((angle_rad(by_angles[row], on_arc[row]) * _reach_mm(motion)).argmax())
            name = WHOLE_SKELETON[joint].name
            farthest = BetweenFrames(float(apart_mm[row]), name, motion.start_frame + start + row)
    return farthest


def _overlapping(
    motion: SkeletonMotion, convention: Convention
) -> Iterator[tuple[int, Float[np.ndarray, "frames joints 4"]]]:
    """Blocks of the rotations in a file, each from the last frame of the block before, and the first row of each."""
    for rows in frame_blocks(len(motion.root_m) - 1):
        yield rows.start, convention.parent_from_joint(motion.parent_from_joint[rows.start : rows.stop + 1])


def _reach_mm(motion: SkeletonMotion) -> Float[np.ndarray, " joints"]:
    """Length of the bones from each joint to the farthest place that its rotation moves."""
    reach_m = np.zeros(len(motion.bone_length_m))
    for index, parent in reversed(list(enumerate(parents_of(len(reach_m)).tolist()))[1:]):
        reach_m[parent] = max(reach_m[parent], reach_m[index] + motion.bone_length_m[index])
    return reach_m * _MM_PER_M


def chained(
    root: Float[np.ndarray, "frames 3"],
    offsets: Float[np.ndarray, "joints 3"],
    parent_from_joint: Float[np.ndarray, "frames joints 3 3"],
) -> Float[np.ndarray, "frames joints 3"]:
    """Positions of all joints from the position of the root and the rotation of each joint."""
    positions = np.empty((len(root), len(offsets), 3))
    file_from_joint = parent_from_joint.copy()
    positions[:, 0] = root
    for index, parent in enumerate(parents_of(len(offsets)).tolist()[1:], 1):
        positions[:, index] = positions[:, parent] + file_from_joint[:, parent] @ offsets[index]
        file_from_joint[:, index] = file_from_joint[:, parent] @ parent_from_joint[:, index]
    return positions


def matrices(quat_xyzw: Float[np.ndarray, "frames joints 4"]) -> Float[np.ndarray, "frames joints 3 3"]:
    """Matrices of quaternions (x, y, z, w)."""
    return Rotation.from_quat(quat_xyzw.reshape(-1, 4)).as_matrix().reshape(*quat_xyzw.shape[:2], 3, 3)
