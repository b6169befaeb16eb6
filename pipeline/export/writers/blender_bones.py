"""Blender's reading of BVH: bones, and angles between two frames.

Blender's importer (5.0.1, ``io_anim_bvh``) gives each bone the rotation mode with the letters of its channels. The mode
``ZXY`` is R = Ry Rx Rz, while the channels ``Zrotation Xrotation Yrotation`` are R = Rz Rx Ry, and its angles are about
the axes of the bone. So Blender converts each frame's rotation, and interpolates other angles than those in the file.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.export.writers.euler import halfway_by_angles
from pipeline.motion.skeleton.model import INDEX, children_of, skeleton_of

# Length in the file's unit up to which a bone has no direction, and deviation up to which it points straight down.
_NO_LENGTH, _STRAIGHT_DOWN = 1e-3, 2.5e-4
_HALF_TURN_ABOUT_Z = (0.0, 0.0, 1.0, 0.0)


def file_from_bones(offsets: Float[np.ndarray, "joints 3"]) -> Float[np.ndarray, "joints 3 3"]:
    """Rotations from the axes of Blender's bones in the rest pose to the file's axes.

    A bone points along its y axis to the middle of its children. Its other axes follow from the shortest rotation of
    the file's y axis to this direction. ``offsets`` are from the parents, in the file's axes and unit.
    """
    children = children_of(len(offsets))
    quat_xyzw = np.tile([0.0, 0.0, 0.0, 1.0], (len(offsets), 1))
    for index, joint in enumerate(skeleton_of(len(offsets))):
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
