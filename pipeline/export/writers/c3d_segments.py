"""Poses of a body's segments for C3D files, in the axes and by the names that Visual3D and Theia3D use.

The axes are X to the right, Y to the front and Z up along the segment in the anatomical position; they are those of
``pipeline.motion.angles.definitions`` in another order. The origin of a segment is its proximal joint.
"""

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np
from jaxtyping import Float

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.data.people import Track3D
from pipeline.core.joints import JointSet
from pipeline.motion.angles.compute import observed
from pipeline.motion.angles.definitions import SEGMENTS
from pipeline.motion.skeleton.model import INDEX, posed_joints

_TRUNK = {"pelvis": "pelvis", "thorax": "torso", "head": "head"}
_LIMBS = {
    "thigh": "thigh",
    "shank": "shank",
    "foot": "foot",
    "upper_arm": "uarm",
    "forearm": "larm",
    "hand": "hand",
}
SEGMENT_LABELS: Mapping[str, str] = MappingProxyType(
    {name: f"{label}_4X4" for name, label in _TRUNK.items()}
    | {f"{side}_{name}": f"{side[0]}_{label}_4X4" for side in ("left", "right") for name, label in _LIMBS.items()}
)
"""Labels of the segments by their names in ``pipeline.motion.angles.definitions``."""
# Columns of Visual3D's axes among those of ISB's: right, front, up.
_RIGHT_FRONT_UP = [2, 0, 1]


def segment_poses(motion: SkeletonMotion, rows: slice) -> Float[np.ndarray, "frames segments 4 4"]:
    """Poses ``world_from_segment`` of the segments of ``SEGMENT_LABELS`` in some rows of a motion; places in metres."""
    part = replace(motion, root_m=motion.root_m[rows], parent_from_joint=motion.parent_from_joint[rows])
    positions_m, world_from_joint = posed_joints(part)
    poses = np.zeros((len(positions_m), len(SEGMENT_LABELS), 4, 4))
    for number, name in enumerate(SEGMENT_LABELS):
        segment = SEGMENTS[name]
        joint = INDEX[segment.joint]
        poses[:, number, :3, :3] = (world_from_joint[joint] @ segment.rest_from_segment)[..., _RIGHT_FRONT_UP]
        poses[:, number, :3, 3] = positions_m[:, joint]
    poses[..., 3, 3] = 1.0
    return poses


def segment_reliability(track: Track3D, joints: JointSet) -> Float[np.ndarray, "frames segments"]:
    """1 in frames in which all landmarks of a segment have a position, otherwise 0: the pose is that of the fit."""
    known = observed(track, joints)
    return np.stack([known[name] for name in SEGMENT_LABELS], axis=1).astype(float)
