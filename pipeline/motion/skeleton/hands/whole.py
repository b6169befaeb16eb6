"""Whole bodies: hands beside the body's own joints, in tracks, observations and motions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from pipeline.core.data.animation import Side, SkeletonMotion
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.people import Observations, Source, Track3D
from pipeline.core.joints import FINGER_JOINTS, FINGERS, JointSet, finger_joints
from pipeline.geometry.tracks import reproject
from pipeline.motion.skeleton.feet.floor import SIDES
from pipeline.motion.skeleton.hands.anatomy import hand_fingers, joint_rotations
from pipeline.motion.skeleton.hands.hand_fit import FittedHand, HandViews, fingers_m, fit_hand, seen_well
from pipeline.motion.skeleton.model import INDEX, SKELETON, WHOLE_SKELETON
from pipeline.motion.skeleton.rotations import continuous_quat_xyzw
from pipeline.motion.skeleton.time_series import windows

# Fewest frames that say anything about a bone, frames that adult proportions count for, and plausible ratios to them.
_FEWEST, _PRIOR_FRAMES = 5, 20
_RATIOS = (0.6, 1.6)
# Ratio of a person's hand to the hand of an adult with the same forearm.
_HAND_RATIOS = (0.75, 1.3)
# Median of the squared length of a vector of three standard normal values.
_MEDIAN_CHI2 = 2.366


def whole_lengths_m(
    body_length_m: Float[np.ndarray, " joints"],
    track: Track3D,
    joints: JointSet,
    is_seen: Mapping[Side, Bool[np.ndarray, " frames"]],
) -> Float[np.ndarray, " whole"]:
    """Length of every bone of ``WHOLE_SKELETON``, from the lengths of the body's bones and located fingers.

    A bone's length is the median over the frames of both hands, less the part that is due to noise, drawn to adult
    proportions at the size of the person's hand. Adult proportions at the size of the forearm remain where nothing was
    measured. ``is_seen`` are the frames in which each hand was seen well.
    """
    forearm = INDEX["LeftHand"]
    stature_m = body_length_m[forearm] / SKELETON[forearm].stature_share
    lengths_m = np.array([joint.stature_share for joint in WHOLE_SKELETON]) * stature_m
    lengths_m[: len(SKELETON)] = body_length_m
    names = [(name, number) for name in FINGERS for number in range(len(FINGERS[name]))]
    measured = [_bone_m(name, number, track, joints, is_seen) for name, number in names]
    numbers = [hand_fingers("left")[name].joints[number] for name, number in names]
    ratios = [length_m / lengths_m[k] for (length_m, count), k in zip(measured, numbers, strict=True) if count]
    size = float(np.clip(np.median(ratios), *_HAND_RATIOS)) if ratios else 1.0
    for (name, number), (length_m, count), k in zip(names, measured, numbers, strict=True):
        usual_m = size * lengths_m[k]
        own_m = np.clip(length_m, _RATIOS[0] * usual_m, _RATIOS[1] * usual_m) if count else usual_m
        for side in SIDES:
            drawn_m = (count * own_m + _PRIOR_FRAMES * usual_m) / (count + _PRIOR_FRAMES)
            lengths_m[hand_fingers(side)[name].joints[number]] = drawn_m
    return lengths_m


def _bone_m(
    name: str,
    number: int,
    track: Track3D,
    joints: JointSet,
    is_seen: Mapping[Side, Bool[np.ndarray, " frames"]],
) -> tuple[float, int]:
    """Length of the bone to a joint of a finger by both hands, and the number of frames; 0 if they are too few."""
    squared_m2, noise_m2 = [np.zeros(0)], [np.zeros(0)]
    for side in SIDES:
        end = f"{side}_{name}_{FINGERS[name][number]}"
        start = f"{side}_{name}_{FINGERS[name][number - 1]}" if number else f"{side}_wrist"
        if not {start, end} <= set(joints.names):
            continue
        bone_m = track.xyz_m[:, joints.index(end)] - track.xyz_m[:, joints.index(start)]
        bone_m = np.where(is_seen[side][:, None], bone_m, np.nan)
        known = np.isfinite(bone_m).all(-1)
        squared_m2.append((bone_m[known] ** 2).sum(-1))
        second_m2 = (np.diff(bone_m, n=2, axis=0) ** 2).sum(-1)
        noise_m2.append(second_m2[np.isfinite(second_m2)])
    lengths_m2, seconds_m2 = np.concatenate(squared_m2), np.concatenate(noise_m2)
    if len(lengths_m2) < _FEWEST:
        return np.nan, 0
    # The second difference of noise has six times its variance. Across the bone, noise of two axes lengthens it.
    variance_m2 = float(np.median(seconds_m2)) / (6 * _MEDIAN_CHI2) if len(seconds_m2) else 0.0
    median_m2 = float(np.median(lengths_m2))
    return float(np.sqrt(max(median_m2 - 2 * variance_m2, median_m2 / 4))), len(lengths_m2)


@dataclass(frozen=True, slots=True, eq=False)
class FittedHands:
    """Both hands of a person, fitted on the body."""

    bone_length_m: Float[np.ndarray, " whole"]  # Length of each bone of ``WHOLE_SKELETON``
    # Observations and fit of each hand
    views: Mapping[Side, HandViews]
    fitted: Mapping[Side, FittedHand]


def has_fingers(joints: JointSet) -> bool:
    """Tell if a joint set has joints of fingers."""
    return not FINGER_JOINTS.isdisjoint(joints.names)


def selected(
    track: Track3D, seen: Observations, joints: JointSet, names: Sequence[str]
) -> tuple[Track3D, Observations]:
    """Joints of a track and of its observations, in the order of ``names``."""
    if tuple(names) == joints.names:
        return track, seen
    columns = joints.indices(tuple(names))
    sigma_m = track.uncertainty_m
    part = replace(
        track,
        xyz_m=track.xyz_m[:, columns],
        score=track.score[:, columns],
        source=track.source[:, columns],
        error_px=track.error_px[:, columns],
        views=track.views[:, columns],
        uncertainty_m=None if sigma_m is None else sigma_m[:, columns],
    )
    return part, replace(seen, points_px=seen.points_px[:, :, columns], score=seen.score[:, :, columns])


def views_of_hands(
    track: Track3D, seen: Observations, joints: JointSet, frame_rate_hz: float
) -> Mapping[Side, HandViews]:
    """Observations of a person's left and right hand.

    Joints of ``track``, fingers included, are located or smoothed.
    """
    return {side: _hand_views(side, track, seen, joints, frame_rate_hz) for side in SIDES}


def unseen(views: HandViews) -> HandViews:
    """The same hand, as if no frame showed it well enough for a fit."""
    return replace(views, is_seen=np.zeros_like(views.is_seen))


def fit_hands(
    body: SkeletonMotion,
    track: Track3D,
    views: Mapping[Side, HandViews],
    joints: JointSet,
    cameras: Sequence[Camera] | None,
    lengths_m: Float[np.ndarray, " whole"] | None = None,
) -> FittedHands:
    """Fit both hands of a person.

    The fit follows the rays of ``cameras``; ``None``: the positions. ``lengths_m`` are the lengths of bones; ``None``:
    they are measured in ``track``.
    """
    is_seen = {side: view.is_seen for side, view in views.items()}
    if lengths_m is None:
        lengths_m = whole_lengths_m(body.bone_length_m, track, joints, is_seen)
    fitted = {side: fit_hand(side, body, lengths_m, view, cameras) for side, view in views.items()}
    return FittedHands(lengths_m, views, fitted)


def _hand_views(side: Side, track: Track3D, seen: Observations, joints: JointSet, frame_rate_hz: float) -> HandViews:
    names = finger_joints(side)
    known = [number for number, name in enumerate(names) if name in joints.names]
    part, of_part = selected(track, seen, joints, [names[number] for number in known])
    num_frames, num_cameras = seen.score.shape[:2]
    xyz_m = np.full((num_frames, len(names), 3), np.nan)
    measured = np.zeros((num_frames, len(names)), dtype=bool)
    points_px = np.full((num_frames, num_cameras, len(names), 2), np.nan)
    score = np.zeros((num_frames, num_cameras, len(names)))
    measured[:, known] = part.source == Source.MEASURED
    xyz_m[:, known] = np.where(measured[:, known, None], part.xyz_m, np.nan)
    points_px[:, :, known], score[:, :, known] = of_part.points_px, of_part.score
    wrist = f"{side}_wrist"
    wrist_m = track.xyz_m[:, joints.index(wrist)] if wrist in joints.names else np.full((num_frames, 3), np.nan)
    return HandViews(xyz_m, points_px, score, seen_well(wrist_m, xyz_m, measured, frame_rate_hz))


def with_hands(body: SkeletonMotion, hands: FittedHands) -> SkeletonMotion:
    """Add hands to the motion of a body: its wrists are turned, and it has the joints of ``WHOLE_SKELETON``."""
    quat = np.zeros((len(body.root_m), len(WHOLE_SKELETON), 4))
    quat[..., 3] = 1.0
    quat[:, : body.parent_from_joint.shape[1]] = body.parent_from_joint
    for side, fitted in hands.fitted.items():
        quat[:, INDEX[f"{side.capitalize()}Hand"]] = continuous_quat_xyzw(fitted.pose.forearm_from_hand)
        numbers, rotations = joint_rotations(side, fitted.pose.angle_rad)
        for number, rotation in zip(numbers.tolist(), rotations, strict=True):
            quat[:, number] = continuous_quat_xyzw(rotation)
    return replace(body, bone_length_m=read_only(hands.bone_length_m), parent_from_joint=read_only(quat))


def with_fingers(body: Track3D, fingers: Track3D, joints: JointSet) -> Track3D:
    """Joints of a body and of its fingers in the order of a joint set.

    Those without and those with a finger's name are each in the order of the set.
    """
    on_fingers = np.array([name in FINGER_JOINTS for name in joints.names])

    def joined(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        both = np.empty((first.shape[0], len(joints.names), *first.shape[2:]), first.dtype)
        both[:, ~on_fingers], both[:, on_fingers] = first, second
        return read_only(both)

    sigma_m = None
    if body.uncertainty_m is not None:
        unknown = np.full(fingers.source.shape, np.nan)
        sigma_m = joined(body.uncertainty_m, unknown if fingers.uncertainty_m is None else fingers.uncertainty_m)
    return replace(
        body,
        xyz_m=joined(body.xyz_m, fingers.xyz_m),
        score=joined(body.score, fingers.score),
        source=joined(body.source, fingers.source),
        error_px=joined(body.error_px, fingers.error_px),
        views=joined(body.views, fingers.views),
        uncertainty_m=sigma_m,
    )


def follow_hands(
    final: Track3D,
    body: SkeletonMotion,
    hands: FittedHands,
    located: Track3D,
    seen: Observations,
    joints: JointSet,
    cameras: Sequence[Camera],
) -> Track3D:
    """Track of the fingers as the fit has them, in the order of the joint set.

    Fingers have a position wherever the wrist has one. They are measured where the hand was seen well and the joint was
    located, and predicted elsewhere. ``final`` are the joints of the body, ``body`` is its motion without hands;
    ``joints`` is the set of the ``located`` fingers.
    """
    names = [name for name in joints.names if name in FINGER_JOINTS]
    fingers, of_fingers = selected(located, seen, joints, names)
    body_names = [name for name in joints.names if name not in FINGER_JOINTS]
    xyz_m, sigma_m = np.full(fingers.xyz_m.shape, np.nan), np.full(fingers.source.shape, np.nan)
    source = np.full(fingers.source.shape, Source.ABSENT, fingers.source.dtype)
    error_px = np.full(fingers.error_px.shape, np.nan)
    for rows in windows(len(xyz_m), overlap=0):
        for side in SIDES:
            order = finger_joints(side)
            columns = [number for number, name in enumerate(names) if name in order]
            if not columns or f"{side}_wrist" not in body_names:
                continue
            known = np.isfinite(final.xyz_m[rows, body_names.index(f"{side}_wrist")]).all(-1)
            fitted, of_hand = hands.fitted[side], [order.index(names[number]) for number in columns]
            posed_m = fingers_m(side, body, hands.bone_length_m, fitted.pose, rows)[:, of_hand]
            xyz_m[rows, columns] = np.where(known[:, None, None], posed_m, np.nan)
            measured = hands.views[side].is_seen[rows, None] & (fingers.source[rows][:, columns] == Source.MEASURED)
            here = np.where(measured, Source.MEASURED, Source.PREDICTED)
            source[rows, columns] = np.where(known[:, None], here, Source.ABSENT)
            if fitted.uncertainty_m is not None:
                stated_m = fitted.uncertainty_m[rows][:, of_hand]
                sigma_m[rows, columns] = np.where(known[:, None], stated_m, np.nan)
        error_px[rows], _, _ = reproject(cameras, xyz_m[rows], of_fingers.points_px[rows], of_fingers.score[rows])
    return replace(fingers, xyz_m=xyz_m, source=source, error_px=error_px, uncertainty_m=sigma_m)
