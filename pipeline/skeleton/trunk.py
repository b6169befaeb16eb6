"""Torso and head of every frame: where they are and how they are turned."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from pipeline.skeleton.gaps import carried, filled_linearly
from pipeline.skeleton.landmarks import Landmarks
from pipeline.skeleton.model import INDEX, TRUNK
from pipeline.skeleton.rotations import align, filled, from_axes, unit

_NOTHING = np.zeros(3)
_LEFT = np.array([1.0, 0.0, 0.0])
_UP = np.array([0.0, 0.0, 1.0])

# Where a face's landmarks lie in an upright head that faces -Y, from the centre between the ears (adult means, metres).
_FACE_M = {
    "nose": (0.0, -0.110, -0.010),
    "left_eye": (0.032, -0.080, 0.020),
    "right_eye": (-0.032, -0.080, 0.020),
    "left_ear": (0.075, 0.0, 0.0),
    "right_ear": (-0.075, 0.0, 0.0),
}
# The direction from the base of the neck to the face counts like a landmark so far away: it steadies nods and tilts.
_NECK_LEVER_M = 0.05
# A face that misses its landmarks by more than this (root mean square, metres), or that is turned farther away from the
# chest than a neck can turn it, was not measured well enough to believe.
_MAX_FACE_MISFIT_M = 0.04
_MAX_NECK_TURN = np.radians(90.0)
# The centre between the ears as seen from the base of the neck, upright.
_EARS_FROM_NECK_M = np.array([0.0, 0.0, 0.2])


@dataclass(frozen=True, slots=True, eq=False)
class Torso:
    """Centres of hips and shoulders, orientations of pelvis and chest, known in every frame."""

    hips_m: Float[np.ndarray, "frames 3"]
    shoulders_m: Float[np.ndarray, "frames 3"]
    world_from_pelvis: Rotation
    world_from_chest: Rotation


@dataclass(frozen=True, slots=True, eq=False)
class Head:
    """Centre between the ears, orientation of the head, and the frames in which they are known."""

    center_m: Float[np.ndarray, "frames 3"]
    world_from_head: Rotation
    valid: Bool[np.ndarray, " frames"]


def _girdle_center_m(
    landmarks: Landmarks, kind: str, axis: Float[np.ndarray, "frames 3"], half_width_m: float
) -> Float[np.ndarray, "frames 3"]:
    """Centre of shoulders or hips; where one side is unknown, half the width away from the other one."""
    center = landmarks.middle(kind)
    from_left = landmarks[f"left_{kind}"] - half_width_m * axis
    from_right = landmarks[f"right_{kind}"] + half_width_m * axis
    return np.where(np.isfinite(center), center, np.where(np.isfinite(from_left), from_left, from_right))


def solve_torso(landmarks: Landmarks, bone_length_m: Float[np.ndarray, " joints"]) -> Torso:
    """Hips, shoulders, pelvis and chest of every frame.

    The pelvis' X axis runs along the hips and the chest's along the shoulders, exactly; both point up along the trunk.
    Where the hips are unknown they travel with the shoulders, and the other way round. A person of whom neither was
    ever seen stands upright above the world's origin.
    """
    hip_axis = unit(landmarks["left_hip"] - landmarks["right_hip"])
    shoulder_axis = unit(landmarks["left_shoulder"] - landmarks["right_shoulder"])
    shoulder_axis = unit(carried(shoulder_axis, filled_linearly(hip_axis, _LEFT), _NOTHING))
    hip_axis = unit(carried(hip_axis, filled_linearly(shoulder_axis, _LEFT), _NOTHING))

    trunk = bone_length_m[[INDEX[name] for name in TRUNK]].sum() * _UP
    hips_m = _girdle_center_m(landmarks, "hip", hip_axis, float(bone_length_m[INDEX["LeftUpLeg"]]))
    shoulders_m = _girdle_center_m(landmarks, "shoulder", shoulder_axis, float(bone_length_m[INDEX["LeftArm"]]))
    shoulders_m = carried(shoulders_m, filled_linearly(hips_m, _NOTHING), trunk)
    hips_m = carried(hips_m, shoulders_m, -trunk)
    return Torso(
        hips_m,
        shoulders_m,
        filled(*from_axes(hip_axis, shoulders_m - hips_m)),
        filled(*from_axes(shoulder_axis, shoulders_m - hips_m)),
    )


def solve_head(landmarks: Landmarks, torso: Torso) -> Head:
    """Lay a face of adult size onto whatever landmarks are known, at least two of nose, eyes and ears.

    So a landmark that comes or goes doesn't make the head jump. The head is unknown, its centre NaN and its orientation
    arbitrary, where fewer are known or where they don't make a face that looks where this chest allows.
    """
    template = np.array(list(_FACE_M.values()))
    face = np.stack([landmarks[name] for name in _FACE_M], axis=1)
    known = np.isfinite(face).all(-1)
    enough = known.sum(-1) >= 2

    share = np.where(enough[:, None], known, np.nan) / np.where(enough, known.sum(-1), 1)[:, None]
    center = np.einsum("fp,fpi->fi", share, np.where(known[..., None], face, 0.0))
    template_center = share @ template
    # Vectors from the centre of the known landmarks, and the one from the neck: rotation alone is left to find.
    neck = _NECK_LEVER_M * unit(center - torso.shoulders_m)
    upright_neck = _NECK_LEVER_M * unit(template_center + _EARS_FROM_NECK_M)
    measured = np.concatenate([face - center[:, None], neck[:, None]], axis=1)
    upright = np.concatenate([template - template_center[:, None], upright_neck[:, None]], axis=1)
    world_from_head = align(upright, measured)

    laid = np.einsum("fij,fpj->fpi", world_from_head.as_matrix(), upright)
    misfit_m = np.sqrt((share * np.nan_to_num((laid - measured)[:, :-1] ** 2).sum(-1)).sum(-1))
    turn = (torso.world_from_chest.inv() * world_from_head).magnitude()
    valid = enough & (misfit_m < _MAX_FACE_MISFIT_M) & (turn < _MAX_NECK_TURN)
    ears_m = center - world_from_head.apply(np.where(enough[:, None], template_center, 0.0))
    return Head(np.where(valid[:, None], ears_m, np.nan), world_from_head, valid)
