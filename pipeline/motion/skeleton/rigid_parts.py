"""Orientation of torso, head and feet in each frame, from landmarks on these rigid parts of the body."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from pipeline.core.data.people import Track3D
from pipeline.core.joints import JointSet
from pipeline.motion.skeleton.landmarks import Landmarks
from pipeline.motion.skeleton.model import INDEX, TRUNK
from pipeline.motion.skeleton.rotations import align, filled, from_axes, unit
from pipeline.motion.skeleton.time_series import filled_linearly, filled_relative_to

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

    The X axis of the pelvis is along the hips, and the chest's along the shoulders; both Z axes point up along
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


# Positions of landmarks in an upright head that faces -Y, from the centre between the ears (adult means, metres).
_FACE_M = {
    "nose": (0.0, -0.110, -0.010),
    "left_eye": (0.032, -0.080, 0.020),
    "right_eye": (-0.032, -0.080, 0.020),
    "left_ear": (0.075, 0.0, 0.0),
    "right_ear": (-0.075, 0.0, 0.0),
}
# The direction from the base of the neck to the face has the influence of a landmark at this distance. It stabilises
# nod and tilt.
_NECK_LEVER_M = 0.05
# Limits of a plausible face: root mean square distance to its landmarks (metres), and rotation from the chest.
_MAX_FACE_MISFIT_M = 0.04
_MAX_NECK_TURN = np.radians(90.0)
# Position of the centre between the ears from the base of the neck, in an upright head.
_EARS_FROM_NECK_M = np.array([0.0, 0.0, 0.2])
# Positions of landmarks in a left foot that points to -Y, from the ankle (adult means, metres).
_FOOT_M = {"heel": (0.0, 0.050, -0.060), "big_toe": (-0.030, -0.170, -0.066), "small_toe": (0.045, -0.140, -0.066)}
_MIRRORED = np.array([-1.0, 1.0, 1.0])
# A foot is flat on the floor where all its marks are this close to their lowest heights, a quantile of the frames. From
# as many such frames, its own pitch on the floor is learnt, up to a limit.
_FLAT_M, _LOWEST_SHARE, _FEWEST_FLAT, _MAX_PITCH_RAD = 0.02, 0.2, 10, np.radians(30.0)
# Angle between a flat foot's sole and its marks' plane: marks are at different heights above the sole.
_NEARLY_LEVEL_RAD = np.radians(20.0)
# Number of frames, evenly spaced over the track, for the medians of a person's own proportions.
_NUM_SAMPLES = 400


@dataclass(frozen=True, slots=True, eq=False)
class HeadPose:
    """Centre between the ears, orientation of the head, and the frames in which they are known."""

    center_m: Float[np.ndarray, "frames 3"]
    world_from_head: Rotation
    valid: Bool[np.ndarray, " frames"]


@dataclass(frozen=True, slots=True, eq=False)
class Foot:
    """Orientation of a foot, and the frames in which it is known; arbitrary elsewhere."""

    world_from_foot: Rotation
    valid: Bool[np.ndarray, " frames"]


def solve_head(landmarks: Landmarks, torso: Torso) -> HeadPose:
    """Align a face of adult size with the known landmarks: at least two of nose, eyes and ears.

    So the head does not jump when a landmark appears or disappears. Where fewer landmarks are known, or where the face
    is not plausible, the head is unknown: its centre is NaN and its orientation arbitrary.
    """
    template = np.array(list(_FACE_M.values()))
    face = np.stack([landmarks[name] for name in _FACE_M], axis=1)
    known = np.isfinite(face).all(-1)
    enough = known.sum(-1) >= 2

    share = np.where(enough[:, None], known, np.nan) / np.where(enough, known.sum(-1), 1)[:, None]
    center = np.einsum("fp,fpi->fi", share, np.where(known[..., None], face, 0.0))
    template_center = share @ template
    # Vectors from the centre of the known landmarks, and the vector from the neck: only a rotation remains unknown.
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
    return HeadPose(np.where(valid[:, None], ears_m, np.nan), world_from_head, valid)


def solve_foot(landmarks: Landmarks, side: str) -> Foot:
    """Align a foot of adult shape with at least two of heel, big toe and small toe, relative to the ankle."""
    template = np.array(list(_FOOT_M.values())) * (1.0 if side == "left" else _MIRRORED)
    from_ankle_m = np.stack([landmarks[f"{side}_{name}"] - landmarks[f"{side}_ankle"] for name in _FOOT_M], axis=1)
    valid = np.isfinite(from_ankle_m).all(-1).sum(-1) >= 2
    return Foot(align(np.broadcast_to(template, from_ankle_m.shape), from_ankle_m), valid)


def landmark_offsets_m(
    track: Track3D, joints: JointSet, bone_length_m: Float[np.ndarray, " joints"]
) -> Mapping[str, Float[np.ndarray, " 3"]]:
    """Median offsets of a person's landmarks in head and feet, by name, in metres.

    Both feet have the same offsets, mirrored; a foot that stands flat is level. Landmarks that were never known
    together with others of the same part are missing.
    """
    sampled = np.unique(np.linspace(0, track.num_frames - 1, _NUM_SAMPLES).round().astype(int))
    landmarks = Landmarks(track.xyz_m[sampled], track.source[sampled], joints)
    head = solve_head(landmarks, solve_torso(landmarks, bone_length_m))
    inside_m = dict(_inside_m(landmarks, tuple(_FACE_M), head.center_m, head.world_from_head, head.valid))
    return {**{name: np.median(face_m, axis=0) for name, face_m in inside_m.items()}, **_foot_offsets_m(landmarks)}


def _foot_offsets_m(landmarks: Landmarks) -> Mapping[str, Float[np.ndarray, " 3"]]:
    inside_m: dict[str, list[np.ndarray]] = {}
    pitch_rad = [np.zeros(0)]
    for side, mirrored in (("left", np.ones(3)), ("right", _MIRRORED)):
        foot = solve_foot(landmarks, side)
        names = tuple(f"{side}_{name}" for name in _FOOT_M)
        for name, points_m in _inside_m(landmarks, names, landmarks[f"{side}_ankle"], foot.world_from_foot, foot.valid):
            inside_m.setdefault(name.removeprefix(f"{side}_"), []).append(points_m * mirrored)
        pitch_rad.append(_flat_pitch_rad(landmarks, names, foot))
    flat_rad = np.concatenate(pitch_rad)
    tilt_rad = float(np.median(flat_rad)) if len(flat_rad) >= _FEWEST_FLAT else 0.0
    level = Rotation.from_rotvec([np.clip(tilt_rad, -_MAX_PITCH_RAD, _MAX_PITCH_RAD), 0.0, 0.0])
    offsets = {name: level.apply(np.median(np.concatenate(points_m), axis=0)) for name, points_m in inside_m.items()}
    return {
        f"{side}_{name}": offset_m * mirrored
        for side, mirrored in (("left", np.ones(3)), ("right", _MIRRORED))
        for name, offset_m in offsets.items()
        if f"{side}_{name}" in landmarks.joints.names
    }


def _flat_pitch_rad(landmarks: Landmarks, names: tuple[str, ...], foot: Foot) -> Float[np.ndarray, " flat"]:
    """Angle between sole and floor, about the foot's X axis, in the frames in which a foot is flat on the floor."""
    heights_m = [landmarks[name][:, 2] for name in names if np.isfinite(landmarks[name]).any()]
    flat = foot.valid.copy()
    for height_m in heights_m:
        flat &= np.nan_to_num(height_m, nan=np.inf) <= np.nanquantile(height_m, _LOWEST_SHARE) + _FLAT_M
    # Feet of people who lie, kneel, hang or stand on their hands are at their lowest without being flat.
    flat &= foot.world_from_foot.apply([0.0, 0.0, 1.0])[:, 2] > np.cos(_NEARLY_LEVEL_RAD)
    ahead = foot.world_from_foot.apply([0.0, -1.0, 0.0])[flat]
    return np.asarray(-np.arcsin(np.clip(ahead[:, 2], -1.0, 1.0)))


def _inside_m(
    landmarks: Landmarks,
    names: tuple[str, ...],
    origin_m: Float[np.ndarray, "frames 3"],
    world_from_part: Rotation,
    valid: Bool[np.ndarray, " frames"],
) -> Iterator[tuple[str, Float[np.ndarray, "known 3"]]]:
    """Known positions of landmarks in the axes of a part of the body, by name."""
    for name in names:
        inside_m = world_from_part.inv().apply(landmarks[name] - origin_m)
        known = valid & np.isfinite(inside_m).all(-1)
        if known.any():
            yield name, inside_m[known]
