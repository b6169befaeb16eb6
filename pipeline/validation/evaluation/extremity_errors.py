"""Errors of feet and hands against the truth of a simulation or a rendered session."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.core.data.animation import Side, SkeletonMotion
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Source, Track3D
from pipeline.core.joints import JointSet, finger_joints
from pipeline.motion.skeleton.feet.floor import SIDES
from pipeline.motion.skeleton.model import joint_pose
from pipeline.validation.evaluation.mpjpe import BODY_JOINTS, UNMATCHED, match_frames, select_joints
from pipeline.validation.simulation.scenes import Simulation


def matched_joints(
    tracks: Sequence[Track3D], simulation: Simulation, joints: JointSet, names: Sequence[str]
) -> tuple[Float[np.ndarray, "people frames names 3"], Bool[np.ndarray, "people frames names"]]:
    """Positions of joints of the track that is matched to each person by the body, and whether they are measured.

    World positions are NaN without a match and for names that ``joints`` lacks; a joint is measured if the track's
    source is ``MEASURED``.
    """
    frames = np.arange(simulation.timebase.num_frames)
    truth_m = simulation.truth_m[:, :, simulation.joints.indices(BODY_JOINTS)]
    matched = match_frames(select_joints(tracks, joints, BODY_JOINTS, frames), truth_m)
    no_person = np.full((1, len(frames), len(names), 3), np.nan)
    taken_m = np.concatenate([select_joints(tracks, joints, names, frames), no_person])
    measured = np.zeros(taken_m.shape[:3], dtype=bool)
    shared = [k for k, name in enumerate(names) if name in joints.names]
    columns = [joints.index(names[k]) for k in shared]
    for row, track in enumerate(tracks):
        rows = slice(track.start_frame, track.start_frame + track.num_frames)
        measured[row, rows, shared] = (track.source[:, columns] == Source.MEASURED).T
    row_of = np.where(matched == UNMATCHED, len(tracks), matched)
    return taken_m[row_of, frames], measured[row_of, frames]


def mean_or_none(values: np.ndarray) -> float | None:
    """Mean of the finite values, ``None`` without any."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else None


_NAMES = tuple(f"{side}_{part}" for part in ("heel", "big_toe") for side in SIDES)
_SIDES = (("Left", 1.0), ("Right", -1.0))
_ENDS = ("Foot", "FootEnd")
# A true foot stands while its ankle is slower than this speed and closer than this distance to its lowest height; the
# distance allows for a lifted heel.
_STILL_M_S, _LOW_M = 0.05, 0.04
_SHORTEST_S = 0.1
# Tolerance of the start and of the end of a contact.
_TOLERANCE_S = 0.08


def score_heels_and_toes(
    tracks: Sequence[Track3D], simulation: Simulation, joints: JointSet
) -> dict[str, float | None]:
    """Compare heels and toes of tracks with the truth.

    The result has:

    - ``heel_mm``, ``toe_mm``: mean error of heels and of big toes.
    - ``heel_slide_cm``, ``toe_slide_cm``: mean horizontal distance of the heel, and of the big toe, from its median
      position while the true one stands, over stances of at least 0.1 s.
    - ``foot_pitch_deg``, ``foot_heading_deg``: mean absolute error of the angle between the line from heel to toe and
      the floor, and of its heading.

    Each figure is ``None`` without data.
    """
    truth_m = simulation.truth_m[:, :, simulation.joints.indices(_NAMES)]
    predicted_m, _ = matched_joints(tracks, simulation, joints, _NAMES)
    rate_hz = simulation.timebase.frame_rate_hz
    error_mm = 1000 * np.linalg.norm(predicted_m - truth_m, axis=-1)
    along, true_along = (points_m[:, :, 2:] - points_m[:, :, :2] for points_m in (predicted_m, truth_m))
    return {
        "heel_mm": mean_or_none(error_mm[..., :2]),
        "toe_mm": mean_or_none(error_mm[..., 2:]),
        "heel_slide_cm": slide_cm(predicted_m[:, :, :2], standing(truth_m[:, :, :2], rate_hz), rate_hz),
        "toe_slide_cm": slide_cm(predicted_m[:, :, 2:], standing(truth_m[:, :, 2:], rate_hz), rate_hz),
        "foot_pitch_deg": mean_or_none(np.abs(pitch_deg(along) - pitch_deg(true_along))),
        "foot_heading_deg": mean_or_none(np.abs(heading_error_deg(along, true_along))),
    }


def score_foot_directions(
    motions: Sequence[SkeletonMotion],
    timebase: Timebase,
    time_s: Float[np.ndarray, " instants"],
    feet_m: Float[np.ndarray, "people instants 2 2 3"],
) -> dict[str, float | None]:
    """Compare the direction of each motion's feet, from ankle to end, with the true one from ankle to toe base.

    The end of the foot and the toe base are different points: the medians of the differences are their definition, the
    spread around them is error.

    ``time_s``: times of the truth on the session's clock. ``feet_m``: True ankle and toe base of the left and of the
    right foot.

    The result has:

    - ``foot_heading_spread_deg``, ``foot_heading_spread_90_deg``: median and 90th percentile of the headings' absolute
      deviation from their median, outwards positive.
    - ``foot_pitch_spread_deg``, ``foot_pitch_spread_90_deg``: likewise for the angle to the floor.

    Each figure is ``None`` without data. A motion is compared with the person whose left ankle is nearest (median).
    """
    frames = np.rint((time_s - timebase.start_time_s) * timebase.frame_rate_hz).astype(np.int64)
    headings, pitches = [np.zeros(0)], [np.zeros(0)]
    for motion in motions:
        rows, instants = _shared(motion, frames)
        if not len(rows):
            continue
        ends_m = {f"{side}{end}": joint_pose(motion, f"{side}{end}")[0][rows] for side, _ in _SIDES for end in _ENDS}
        apart_m = np.linalg.norm(feet_m[:, instants, 0, 0] - ends_m["LeftFoot"], axis=-1)
        person = int(np.argmin(np.median(np.where(np.isnan(apart_m), np.inf, apart_m), axis=-1)))
        for foot, (side, outwards) in enumerate(_SIDES):
            along = ends_m[f"{side}FootEnd"] - ends_m[f"{side}Foot"]
            true_along = feet_m[person, instants, foot, 1] - feet_m[person, instants, foot, 0]
            headings.append(outwards * heading_error_deg(along, true_along))
            pitches.append(pitch_deg(along) - pitch_deg(true_along))
    return _spread("foot_heading", np.concatenate(headings)) | _spread("foot_pitch", np.concatenate(pitches))


def _shared(
    motion: SkeletonMotion, frames: Int[np.ndarray, " instants"]
) -> tuple[Int[np.ndarray, " shared"], Int[np.ndarray, " shared"]]:
    """Rows of a motion at the instants of the truth, and numbers of these instants."""
    rows = frames - motion.start_frame
    instants = np.flatnonzero((rows >= 0) & (rows < len(motion.root_m)))
    return rows[instants], instants


def _spread(name: str, values_deg: Float[np.ndarray, " n"]) -> dict[str, float | None]:
    known = values_deg[np.isfinite(values_deg)]
    away = np.abs(known - np.median(known)) if len(known) else known
    return {
        f"{name}_spread_deg": float(np.median(away)) if len(away) else None,
        f"{name}_spread_90_deg": float(np.percentile(away, 90)) if len(away) else None,
    }


def pitch_deg(along: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch"]:
    """Angle of a direction from the back to the front of a foot below the horizontal; heel up is positive."""
    return np.degrees(np.arctan2(-along[..., 2], np.linalg.norm(along[..., :2], axis=-1)))


def heading_error_deg(
    predicted: Float[np.ndarray, "*batch 3"], truth: Float[np.ndarray, "*batch 3"]
) -> Float[np.ndarray, "*batch"]:
    """Angle on the floor from a true direction to the predicted direction, positive to the left."""
    cross = truth[..., 0] * predicted[..., 1] - truth[..., 1] * predicted[..., 0]
    return np.degrees(np.arctan2(cross, (truth[..., :2] * predicted[..., :2]).sum(-1)))


def score_feet(
    tracks: Sequence[Track3D], motions: Sequence[SkeletonMotion], simulation: Simulation, joints: JointSet
) -> dict[str, float | None]:
    """Compare the feet of motions with the true feet.

    The result has:

    - ``foot_slide_cm``: mean horizontal distance of the ankle from its median position in a true stance, over stances
      of at least 0.1 s.
    - ``ankle_mm``: mean error of the ankles over all frames.
    - ``contacts_found``: share of the frames of true stances that have a contact.
    - ``contacts_invented``: share of the frames of contacts in which the true foot does not stand, nor within 0.08 s.

    Each figure is ``None`` without data.
    """
    num_frames, rate_hz = simulation.timebase.num_frames, simulation.timebase.frame_rate_hz
    ankles = simulation.joints.indices(tuple(f"{side}_ankle" for side in SIDES))
    truth_m = simulation.truth_m[:, :, ankles]
    stands = standing(truth_m, rate_hz)
    near = stands.copy()
    for shift in range(1, round(_TOLERANCE_S * rate_hz) + 1):
        near[:, shift:] |= stands[:, :-shift]
        near[:, :-shift] |= stands[:, shift:]
    ankles_m, contact = _laid_out(motions, num_frames)
    matched = match_frames(
        select_joints(tracks, joints, BODY_JOINTS, np.arange(num_frames)),
        simulation.truth_m[:, :, simulation.joints.indices(BODY_JOINTS)],
    )
    frames = np.arange(num_frames)
    is_matched = matched >= 0
    matched_m = np.where(is_matched[..., None, None], ankles_m[matched, frames], np.nan)
    touches = contact[matched, frames] & is_matched[..., None]
    return {
        "foot_slide_cm": slide_cm(matched_m, stands, rate_hz),
        "ankle_mm": _mean(1000 * np.linalg.norm(matched_m - truth_m, axis=-1)),
        "contacts_found": _mean(touches[stands & is_matched[..., None]]),
        "contacts_invented": _mean(~near[touches]),
    }


def _mean(values: np.ndarray) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else None


def standing(truth_m: Float[np.ndarray, "people frames 2 3"], rate_hz: float) -> Bool[np.ndarray, "people frames 2"]:
    """Frames in which a true point of a foot is still, and as low as it gets."""
    speed_m_s = np.linalg.norm(np.gradient(truth_m[..., :2], axis=1), axis=-1) * rate_hz
    with np.errstate(invalid="ignore"):
        low = truth_m[..., 2] < np.nanmin(truth_m[..., 2], axis=(1, 2), keepdims=True) + _LOW_M
        return np.asarray((speed_m_s < _STILL_M_S) & low)


def _laid_out(
    motions: Sequence[SkeletonMotion], num_frames: int
) -> tuple[Float[np.ndarray, "tracks frames 2 3"], Bool[np.ndarray, "tracks frames 2"]]:
    """Ankles and contacts of all motions on the session's frames, and an empty entry for unmatched people."""
    ankles_m = np.full((len(motions) + 1, num_frames, 2, 3), np.nan)
    contact = np.zeros((len(motions) + 1, num_frames, 2), dtype=bool)
    for number, motion in enumerate(motions):
        start = motion.start_frame
        for foot, side in enumerate(SIDES):
            ankle_m, _ = joint_pose(motion, f"{side.capitalize()}Foot")
            ankles_m[number, start : start + len(ankle_m), foot] = ankle_m
            for stance in motion.contacts:
                if stance.side == side:
                    contact[number, start + stance.rows.start : start + stance.rows.stop, foot] = True
    return ankles_m, contact


def slide_cm(
    points_m: Float[np.ndarray, "people frames 2 3"], stands: Bool[np.ndarray, "people frames 2"], rate_hz: float
) -> float | None:
    """Mean horizontal distance of points of feet from their median position, over stances of at least 0.1 s."""
    shortest = max(2, round(_SHORTEST_S * rate_hz))
    slid_m: list[np.ndarray] = [np.zeros(0)]
    for person, foot in np.ndindex(stands.shape[0], 2):
        borders: Int[np.ndarray, " _"] = np.flatnonzero(
            np.diff(stands[person, :, foot].astype(np.int8), prepend=0, append=0)
        )
        for start, stop in borders.reshape(-1, 2):
            xy_m = points_m[person, start:stop, foot, :2]
            xy_m = xy_m[np.isfinite(xy_m).all(-1)]
            if len(xy_m) >= shortest:
                slid_m.append(np.linalg.norm(xy_m - np.median(xy_m, axis=0), axis=-1))
    return _mean(100 * np.concatenate(slid_m))


# Largest bend backwards of the knuckles and of the hinges of fingers, and of the thumb's hinges, whose axis is known
# less exactly.
_KNUCKLE_DEG, _HINGE_DEG, _THUMB_DEG = -40.0, -5.0, -15.0
# Direction in which the thumb bends: to the little finger and to the palm (radial and palmar components).
_THUMB_BEND = (-0.8, 0.6)


def score_hands(tracks: Sequence[Track3D], simulation: Simulation, joints: JointSet) -> dict[str, Any]:
    """Compare fingers of tracks with the truth, relative to the wrist.

    The result has:

    - ``finger_mm``, ``finger_p95_mm``: mean error of the fingers' joints relative to the wrist, and its 95th
      percentile, in frames in which the hand is measured.
    - ``finger_all_mm``: mean error in all frames in which the track has fingers, measured or not.
    - ``hands_measured``: share of the true hands and frames in which at least half of the fingers' joints are measured.
    - ``backward_bends``: number of hinges and frames with a finger bent backwards.
    - ``finger_by_joint_mm``: mean error by kind of joint, all fingers and both hands together, in frames in which the
      hand is measured.

    Each figure is ``None`` without data.
    """
    per_hand = len(finger_joints(SIDES[0]))
    names = tuple(name for side in SIDES for name in (f"{side}_wrist", *finger_joints(side)))
    truth_m = simulation.truth_m[:, :, simulation.joints.indices(names)]
    predicted_m, measured = matched_joints(tracks, simulation, joints, names)
    shape = (*truth_m.shape[:2], 2, per_hand + 1)
    difference_m = (predicted_m - truth_m).reshape(*shape, 3)
    error_mm = 1000 * np.linalg.norm(difference_m[:, :, :, 1:] - difference_m[:, :, :, :1], axis=-1)
    is_measured = measured.reshape(shape)[..., 1:].mean(-1) >= 0.5
    of_measured_mm = np.where(is_measured[..., None], error_mm, np.nan)
    known_mm = of_measured_mm[np.isfinite(of_measured_mm)]
    kinds = np.array([name.rpartition("_")[2] for name in finger_joints(SIDES[0])])
    return {
        "finger_mm": mean_or_none(of_measured_mm),
        "finger_p95_mm": float(np.percentile(known_mm, 95)) if known_mm.size else None,
        "finger_all_mm": mean_or_none(error_mm),
        "hands_measured": mean_or_none(is_measured[simulation.present].astype(float)),
        "backward_bends": count_backward_bends(tracks, joints),
        "finger_by_joint_mm": {
            kind: mean_or_none(of_measured_mm[..., kinds == kind]) for kind in dict.fromkeys(kinds.tolist())
        },
    }


def count_backward_bends(tracks: Sequence[Track3D], joints: JointSet) -> int | None:
    """Count the hinges of fingers that bend backwards, over all frames of all tracks.

    A hinge bends backwards if it is bent by more than 5 degrees to the back of the hand, the thumb's hinges by more
    than 15 degrees, and a knuckle by more than 40 degrees. Returns the number of hinges and frames; ``None`` if
    ``joints`` has no hands.
    """
    number = 0
    for side in SIDES:
        names = (f"{side}_wrist", *finger_joints(side))
        if not set(names) <= set(joints.names):
            return None
        for track in tracks:
            bends = bends_deg(track.xyz_m[:, joints.indices(names)], side)
            # Comparisons are false for NaN: hinges of unknown joints.
            number += int((bends[:, :2] < _THUMB_DEG).sum() + (bends[:, 2:6] < _KNUCKLE_DEG).sum())
            number += int((bends[:, 6:] < _HINGE_DEG).sum())
    return number


def bends_deg(hand_m: Float[np.ndarray, "frames 21 3"], side: Side) -> Float[np.ndarray, "frames 14"]:
    """Bends of a hand's hinges in degrees, positive into the palm.

    ``hand_m`` are world positions of the wrist and of ``finger_joints``, NaN where unknown. The bends are at two
    hinges of the thumb, four knuckles, and two hinges of each finger; NaN beside unknown joints.
    """
    wrist_m, thumb_m, *fingers_m = np.split(hand_m, [1, *range(5, 21, 4)], axis=1)
    index_m, middle_m, _, pinky_m = (finger_m[:, 0] for finger_m in fingers_m)
    distal = _unit(middle_m - wrist_m[:, 0])
    across = index_m - pinky_m
    radial = _unit(across - (across * distal).sum(-1, keepdims=True) * distal)
    palmar = np.cross(distal, radial) * (1.0 if side == "left" else -1.0)

    thumb = np.diff(thumb_m, axis=1)
    inwards = _THUMB_BEND[0] * radial + _THUMB_BEND[1] * palmar
    bends = list(_hinges_deg(thumb, np.cross(thumb[:, 0], inwards)))
    segments = [np.diff(finger_m, axis=1) for finger_m in fingers_m]
    bends += [
        np.degrees(np.arctan2((first * palmar).sum(-1), (first * distal).sum(-1)))
        for first in (segment[:, 0] for segment in segments)
    ]
    for segment in segments:
        bends += _hinges_deg(segment, np.cross(distal, palmar))
    return np.stack(bends, axis=-1)


def _hinges_deg(segments: Float[np.ndarray, "frames 3 3"], axis: Float[np.ndarray, "frames 3"]) -> list[np.ndarray]:
    """Angles between consecutive segments, negative if the turn is against the axis."""
    first, second = segments[:, :-1], segments[:, 1:]
    turn = np.cross(first, second)
    size = np.arctan2(np.linalg.norm(turn, axis=-1), (first * second).sum(-1))
    signed = np.degrees(np.copysign(size, (turn * axis[:, None]).sum(-1)))
    return list(signed.T)


def _unit(vectors: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0, length, np.nan))
