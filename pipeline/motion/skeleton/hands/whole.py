"""Whole bodies: hands beside the body's own joints, in tracks, observations and motions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from pipeline.core.data.animation import Side, SkeletonMotion
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.people import Observations, Source, Track3D
from pipeline.core.joints import FINGER_JOINTS, JointSet, finger_joints
from pipeline.geometry.tracks import reproject
from pipeline.motion.skeleton.feet.floor import SIDES
from pipeline.motion.skeleton.fitting.windows import windows
from pipeline.motion.skeleton.hands.anatomy import joint_rotations
from pipeline.motion.skeleton.hands.fit import FittedHand, HandViews, fingers_m, fit_hand
from pipeline.motion.skeleton.hands.proportions import whole_lengths_m
from pipeline.motion.skeleton.hands.start import seen_well
from pipeline.motion.skeleton.model import INDEX, WHOLE_SKELETON
from pipeline.motion.skeleton.rotations import continuous_quat_xyzw


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
    return {side: _views_of(side, track, seen, joints, frame_rate_hz) for side in SIDES}


def unseen(views: HandViews) -> HandViews:
    """The same hand, as if no frame showed it well enough for a fit."""
    return replace(views, is_seen=np.zeros_like(views.is_seen))


def fit_hands(
    body: SkeletonMotion,
    track: Track3D,
    views: Mapping[Side, HandViews],
    joints: JointSet,
    cameras: Sequence[Camera] | None,
) -> FittedHands:
    """Fit both hands of a person.

    ``track`` serves for the lengths of bones. The fit follows the rays of ``cameras``; ``None``: the positions.
    """
    is_seen = {side: view.is_seen for side, view in views.items()}
    lengths_m = whole_lengths_m(body.bone_length_m, track, joints, is_seen)
    fitted = {side: fit_hand(side, body, lengths_m, view, cameras) for side, view in views.items()}
    return FittedHands(lengths_m, views, fitted)


def _views_of(side: Side, track: Track3D, seen: Observations, joints: JointSet, frame_rate_hz: float) -> HandViews:
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
