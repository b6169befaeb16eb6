"""Orders of the rotations of joints, chosen so that programs that interpolate angles stay near the motion."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import SkeletonMotion
from pipeline.export.presets import Convention
from pipeline.export.timelines import frame_blocks
from pipeline.export.writers.euler import ORDERS, angle_rad, halfway_by_angles, halfway_on_arc
from pipeline.motion.skeleton.model import INDEX, WHOLE_SKELETON, child_names, find_skeleton, parent_indices

# Length in the file's unit up to which a bone has no direction, and deviation up to which it points straight down.
_NO_LENGTH, _STRAIGHT_DOWN = 1e-3, 2.5e-4
_HALF_TURN_ABOUT_Z = (0.0, 0.0, 1.0, 0.0)


def file_from_bones(offsets: Float[np.ndarray, "joints 3"]) -> Float[np.ndarray, "joints 3 3"]:
    """Rotations from the axes of Blender's bones in the rest pose to the file's axes.

    A bone points along its y axis to the middle of its children. Its other axes follow from the shortest rotation of
    the file's y axis to this direction. ``offsets`` are from the parents, in the file's axes and unit.
    """
    children = child_names(len(offsets))
    quat_xyzw = np.tile([0.0, 0.0, 0.0, 1.0], (len(offsets), 1))
    for index, joint in enumerate(find_skeleton(len(offsets))):
        direction = offsets[[INDEX[child] for child in children[joint.name]]].sum(0)
        length = np.linalg.norm(direction)
        if length > _NO_LENGTH:
            x, y, z = direction / length
            is_down = y < 0.0 and np.hypot(x, z) < _STRAIGHT_DOWN
            quat_xyzw[index] = _HALF_TURN_ABOUT_Z if is_down else (z, 0.0, -x, 1.0 + y)
    return Rotation.from_quat(quat_xyzw).as_matrix()


def halfway_in_blender(
    quat_xyzw: Float[np.ndarray, "frames joints 4"],
    orders: Sequence[str],
    file_from_bone: Float[np.ndarray, "joints 3 3"],
) -> Float[np.ndarray, "_ joints 4"]:
    """Rotations (x, y, z, w) half-way between consecutive frames, as Blender interpolates them.

    ``orders`` has the axes of each joint's channels, such as ``ZXY``; ``file_from_bone`` is of ``file_from_bones``.
    """
    in_bones = _in_axes(quat_xyzw, file_from_bone.swapaxes(-1, -2))
    return _in_axes(halfway_by_angles(in_bones, [order[::-1] for order in orders]), file_from_bone)


def _in_axes(
    quat_xyzw: Float[np.ndarray, "frames joints 4"], turns: Float[np.ndarray, "joints 3 3"]
) -> Float[np.ndarray, "frames joints 4"]:
    """Same rotations in other axes: of each joint, a vector in the new axes is ``turns`` times the old one."""
    vector = (turns @ quat_xyzw[..., :3, None])[..., 0]
    return np.concatenate([vector, quat_xyzw[..., 3:]], axis=-1)


_MM_PER_M = 1000.0
_USUAL = "ZXY"
# Distance between frames up to which a file keeps the usual order, and a joint in other files: several add up.
_USUAL_UP_TO_MM, _JOINT_UP_TO_MM = 2.0, 0.25

Program = Literal["Blender", "ufbx"]
"""Program that interpolates angles: Blender the angles of its bones, ufbx the angles of the file."""

# Gives rotations (x, y, z, w) half-way between consecutive frames, from the axes of each joint
_Halfway = Callable[[Float[np.ndarray, "frames joints 4"], Sequence[str]], Float[np.ndarray, "_ joints 4"]]


@dataclass(frozen=True, slots=True)
class BetweenFrames:
    """Place at which interpolated angles are farthest off: programs interpolate each angle linearly."""

    program: Program
    # Largest distance of a joint, half-way between two frames, from its place where rotations take the shortest arcs
    distance_mm: float
    joint: str  # Name in the skeleton of the joint whose angles are off
    frame: int  # Earlier frame of the two, an output frame


@dataclass(frozen=True, slots=True)
class RotationOrders:
    """Orders of the rotations of a person's file."""

    axes: tuple[str, ...]  # Axes of each joint of the skeleton, such as ``ZXY``
    between: BetweenFrames | None  # ``None`` for a single frame


@lru_cache(maxsize=1)  # The file asks for it first, then the metrics.
def rotation_orders(motion: SkeletonMotion, convention: Convention, program: Program) -> RotationOrders:
    """Choose the order of the rotations of each joint for a program.

    The order is Z X Y as long as all joints stay within 2 mm half-way between two frames, and where software demands
    it. Interpolated angles are off where the middle angle comes near 90 degrees (gimbal lock). Each order has this
    place at other poses, so each joint whose angles are off gets the order with the least error.
    """
    num_joints = len(motion.bone_length_m)
    usual = (_USUAL,) * num_joints
    between = _between_frames(motion, convention, program, usual)
    if between is None or between.distance_mm <= _USUAL_UP_TO_MM or convention.is_order_demanded:
        return RotationOrders(usual, between)
    halfway = _interpolation(motion, convention, program)
    off_mm = np.zeros((len(ORDERS), num_joints))
    for _, quat in _overlapping(motion, convention):
        on_arc = halfway_on_arc(quat)
        for axes, worst_mm in zip(ORDERS, off_mm, strict=True):
            angles_off_rad = angle_rad(halfway(quat, [axes] * num_joints), on_arc)
            np.maximum(worst_mm, angles_off_rad.max(axis=0) * _reach_mm(motion), out=worst_mm)
    number = ORDERS.index(_USUAL)
    best = np.where(off_mm[number] <= _JOINT_UP_TO_MM, number, off_mm.argmin(axis=0)).tolist()
    chosen = tuple(ORDERS[number] for number in best)
    better = _between_frames(motion, convention, program, chosen)
    # Errors of several joints may cancel each other, so that the best orders are worse together.
    if better is None or better.distance_mm >= between.distance_mm:
        return RotationOrders(usual, between)
    return RotationOrders(chosen, better)


def _interpolation(motion: SkeletonMotion, convention: Convention, program: Program) -> _Halfway:
    """How a program interpolates the rotations of a person's file."""
    if program == "Blender":
        return partial(
            halfway_in_blender, file_from_bone=file_from_bones(convention.rest_offsets(motion.bone_length_m))
        )
    return halfway_by_angles


def _between_frames(
    motion: SkeletonMotion, convention: Convention, program: Program, axes: Sequence[str]
) -> BetweenFrames | None:
    """Find where interpolated angles are farthest off with an order of each joint; ``None`` for a single frame."""
    offsets_mm = convention.rest_offsets(motion.bone_length_m) / convention.units_per_m * _MM_PER_M
    halfway = _interpolation(motion, convention, program)
    farthest: BetweenFrames | None = None
    for start, quat in _overlapping(motion, convention):
        by_angles, on_arc = halfway(quat, axes), halfway_on_arc(quat)
        still = np.zeros((len(on_arc), 3))
        places = [chained(still, offsets_mm, matrices(turns)) for turns in (by_angles, on_arc)]
        apart_mm = np.linalg.norm(places[0] - places[1], axis=-1).max(-1)
        row = int(apart_mm.argmax())
        if farthest is None or apart_mm[row] > farthest.distance_mm:
            joint = int((angle_rad(by_angles[row], on_arc[row]) * _reach_mm(motion)).argmax())
            name = WHOLE_SKELETON[joint].name
            farthest = BetweenFrames(program, float(apart_mm[row]), name, motion.start_frame + start + row)
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
    for index, parent in reversed(list(enumerate(parent_indices(len(reach_m)).tolist()))[1:]):
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
    for index, parent in enumerate(parent_indices(len(offsets)).tolist()[1:], 1):
        positions[:, index] = positions[:, parent] + file_from_joint[:, parent] @ offsets[index]
        file_from_joint[:, index] = file_from_joint[:, parent] @ parent_from_joint[:, index]
    return positions


def matrices(quat_xyzw: Float[np.ndarray, "frames joints 4"]) -> Float[np.ndarray, "frames joints 3 3"]:
    """Matrices of quaternions (x, y, z, w)."""
    return Rotation.from_quat(quat_xyzw.reshape(-1, 4)).as_matrix().reshape(*quat_xyzw.shape[:2], 3, 3)
