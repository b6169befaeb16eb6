"""Poses of skeletons in the forms of other systems: rotations in the world, other axes of segments, the rest pose."""

from collections.abc import Sequence
from functools import cache

import numpy as np
from jaxtyping import Float

from pipeline.motion.skeleton.model import parent_indices, rest_offsets_m
from pipeline.run.live.records import LiveSkeleton

_HALF = np.sqrt(0.5)
FACING_X = np.array([0.0, 0.0, -_HALF, _HALF])
"""Rotation ``joint_from_segment`` of segments whose X axis points ahead in the rest pose, and Y to the left."""
FACING_Y = np.array([0.0, 0.0, 1.0, 0.0])
"""Rotation ``joint_from_segment`` of segments whose Y axis points ahead in the rest pose, and X to the right."""

# Matrices, row by row, of the product with x, y, z and w from the left.
_LEFT = np.array(
    [
        [0, 0, 0, 1, 0, 0, -1, 0, 0, 1, 0, 0, -1, 0, 0, 0],
        [0, 0, 1, 0, 0, 0, 0, 1, -1, 0, 0, 0, 0, -1, 0, 0],
        [0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 1, 0, 0, -1, 0],
        [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
    ],
    np.float64,
)

_COLOURS = ((230, 70, 70), (70, 130, 230), (80, 180, 90), (235, 170, 50), (150, 90, 200), (60, 190, 190))


def person_name(number: int) -> str:
    """Name of a person at receivers, like in file names."""
    return f"person-{number}"


def person_colour(number: int) -> tuple[int, int, int]:
    """Red, green and blue of a person, 0 to 255."""
    return _COLOURS[(number - 1) % len(_COLOURS)]


def product(first: Float[np.ndarray, "*any 4"], second: Float[np.ndarray, "*any 4"]) -> Float[np.ndarray, "*any 4"]:
    """Products of quaternions (x, y, z, w): the second rotation, then the first.

    >>> product(FACING_X, FACING_X).round(6).tolist()
    [0.0, 0.0, -1.0, 0.0]
    """
    matrices = (first @ _LEFT).reshape(*first.shape[:-1], 4, 4)
    return np.asarray((matrices @ second[..., None])[..., 0])


def in_segments(xyz_m: Float[np.ndarray, "*any 3"], joint_from_segment: np.ndarray) -> Float[np.ndarray, "*any 3"]:
    """Vectors in the axes of segments from vectors in the axes of joints; the rotation is about the Z axis."""
    _, _, z, w = joint_from_segment
    cos, sin = w * w - z * z, 2.0 * z * w
    return xyz_m @ np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def world_rotations(skeletons: Sequence[LiveSkeleton]) -> Float[np.ndarray, "people joints 4"]:
    """Rotations of all joints in the world, as quaternions (x, y, z, w); of joints of equal depth at once."""
    rotations = np.array([skeleton.parent_from_joint for skeleton in skeletons])
    parents = parent_indices(rotations.shape[1])
    for joints in _levels(rotations.shape[1]):
        rotations[:, joints] = product(rotations[:, parents[joints]], rotations[:, joints])
    return rotations


@cache
def _levels(num_joints: int) -> list[list[int]]:
    """Joints below the root by their depth."""
    depths = [0]
    for parent in parent_indices(num_joints)[1:].tolist():
        depths.append(depths[parent] + 1)
    return [[joint for joint, depth in enumerate(depths) if depth == level] for level in range(1, max(depths) + 1)]


def rest_joints_m(bone_length_m: Float[np.ndarray, " joints"]) -> Float[np.ndarray, "joints 3"]:
    """Positions of the joints in the rest pose, in our axes: above the origin, the lowest one on the floor."""
    joints_m = rest_offsets_m(bone_length_m)
    for joint, parent in enumerate(parent_indices(len(joints_m)).tolist()):
        if joint:
            joints_m[joint] += joints_m[parent]
    return joints_m - (0.0, 0.0, joints_m[:, 2].min())
