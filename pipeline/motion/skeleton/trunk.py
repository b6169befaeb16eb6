"""Position and orientation of the torso in each frame."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.motion.skeleton.gaps import filled_linearly, filled_relative_to
from pipeline.motion.skeleton.landmarks import Landmarks
from pipeline.motion.skeleton.model import INDEX, TRUNK
from pipeline.motion.skeleton.rotations import filled, from_axes, unit

_NOTHING = np.zeros(3)
_LEFT = np.array([1.0, 0.0, 0.0])
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, slots=True, eq=False)
class Torso:
    """Centres of hips and shoulders, orientations of pelvis and chest, known in every frame."""

    hips_m: Float[np.ndarray, "frames 3"]
    shoulders_m: Float[np.ndarray, "frames 3"]
    world_from_pelvis: Rotation
    world_from_chest: Rotation


def _girdle_center_m(
    landmarks: Landmarks, kind: str, axis: Float[np.ndarray, "frames 3"], half_width_m: float
) -> Float[np.ndarray, "frames 3"]:
    """Centre of shoulders or hips; if a side is unknown, at half the width from the other side."""
    center = landmarks.middle(kind)
    from_left = landmarks[f"left_{kind}"] - half_width_m * axis
    from_right = landmarks[f"right_{kind}"] + half_width_m * axis
    return np.where(np.isfinite(center), center, np.where(np.isfinite(from_left), from_left, from_right))


def solve_torso(landmarks: Landmarks, bone_length_m: Float[np.ndarray, " joints"]) -> Torso:
    """Compute hips, shoulders, pelvis and chest of each frame.

    The X axis of the pelvis is along the hips, and that of the chest along the shoulders; both Z axes point up along
    the trunk. Where the hips are unknown, they move with the shoulders, and vice versa. A person without known hips and
    shoulders stands upright above the world's origin.
    """
    hip_axis = unit(landmarks["left_hip"] - landmarks["right_hip"])
    shoulder_axis = unit(landmarks["left_shoulder"] - landmarks["right_shoulder"])
    shoulder_axis = unit(filled_relative_to(shoulder_axis, filled_linearly(hip_axis, _LEFT), _NOTHING))
    hip_axis = unit(filled_relative_to(hip_axis, filled_linearly(shoulder_axis, _LEFT), _NOTHING))

    trunk = bone_length_m[[INDEX[name] for name in TRUNK]].sum() * _UP
    hips_m = _girdle_center_m(landmarks, "hip", hip_axis, float(bone_length_m[INDEX["LeftUpLeg"]]))
    shoulders_m = _girdle_center_m(landmarks, "shoulder", shoulder_axis, float(bone_length_m[INDEX["LeftArm"]]))
    shoulders_m = filled_relative_to(shoulders_m, filled_linearly(hips_m, _NOTHING), trunk)
    hips_m = filled_relative_to(hips_m, shoulders_m, -trunk)
    return Torso(
        hips_m,
        shoulders_m,
        filled(*from_axes(hip_axis, shoulders_m - hips_m)),
        filled(*from_axes(shoulder_axis, shoulders_m - hips_m)),
    )
