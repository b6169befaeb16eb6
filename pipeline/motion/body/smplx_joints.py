"""Joints of SMPL-X and of MHR, and which joint of our skeleton each is; rotations of our skeleton in axes of SMPL-X.

Names and order: Pavlakos et al., "Expressive Body Capture" (CVPR 2019), and Ferguson et al., "MHR: Momentum Human Rig"
(2025). Both rest in a pose near our T-pose; SMPL-X with Y up and facing Z, so rest directions of bones differ by some
degrees, which a fit of the model takes up.
"""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.joints import SIDES
from pipeline.motion.skeleton.model import INDEX

_BODY = (
    *("pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle"),
    *("spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder"),
    *("right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist"),
)
_FINGERS = ("index", "middle", "pinky", "ring", "thumb")
SMPLX_JOINTS: tuple[str, ...] = (
    *_BODY,
    *("jaw", "left_eye", "right_eye"),
    *(f"{side}_{finger}{bone}" for side in SIDES for finger in _FINGERS for bone in (1, 2, 3)),
)
"""The 55 joints of SMPL-X, in its order."""
NUM_BODY = len(_BODY)
"""Joints of SMPL-X without face and fingers, which are the first ones."""

# Joint of SMPL-X, and of MHR, by the kind of our joint.
_TRUNK = {
    "Hips": ("pelvis", "root"),
    "Spine": ("spine1", "c_spine0"),
    "Chest": ("spine3", "c_spine3"),
    "Neck": ("neck", "c_neck"),
    "Head": ("head", "c_head"),
}
_LIMBS = {
    "UpLeg": ("hip", "upleg"),
    "Leg": ("knee", "lowleg"),
    "Foot": ("ankle", "foot"),
    "Shoulder": ("collar", "clavicle"),
    "Arm": ("shoulder", "uparm"),
    "ForeArm": ("elbow", "lowarm"),
    "Hand": ("wrist", "wrist"),
    **{
        f"Hand{finger.capitalize()}{bone}": (f"{finger}{bone}", f"{finger}{bone}")
        for finger in _FINGERS
        for bone in (1, 2, 3)
    },
}
JOINT_MAP: Mapping[str, tuple[str, str]] = MappingProxyType(
    _TRUNK
    | {
        f"{side.capitalize()}{kind}": (f"{side}_{smplx}", f"{side[0]}_{mhr}")
        for side in SIDES
        for kind, (smplx, mhr) in _LIMBS.items()
    }
)
"""Joints of SMPL-X and of MHR by the name of our joint."""

SMPLX_FROM_OURS: Float[np.ndarray, "3 3"] = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""Rotation from the axes of our rest pose (Z up, facing -Y) to the axes of SMPL-X (Y up, facing Z)."""


def smplx_poses(motion: SkeletonMotion) -> Float[np.ndarray, "frames joints 3"]:
    """Rotation vectors of ``SMPLX_JOINTS`` in a motion, in radians; the world keeps Z up; 0 for joints that we lack."""
    poses = np.zeros((len(motion.root_m), len(SMPLX_JOINTS), 3))
    turn = Rotation.from_matrix(SMPLX_FROM_OURS)
    for name, (smplx, _) in JOINT_MAP.items():
        if INDEX[name] < motion.parent_from_joint.shape[1]:
            local = Rotation.from_quat(motion.parent_from_joint[:, INDEX[name]]) * turn.inv()
            poses[:, SMPLX_JOINTS.index(smplx)] = (local if name == "Hips" else turn * local).as_rotvec()
    return poses
