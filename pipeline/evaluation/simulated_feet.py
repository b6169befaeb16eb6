"""Accuracy of foot contacts on simulated scenes: foot slide, ankle error and contact frames."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.data.animation import SkeletonMotion
from pipeline.data.people import Track3D
from pipeline.evaluation.mpjpe import BODY_JOINTS, match_frames, select_joints
from pipeline.joints import JointSet
from pipeline.simulation.scenes import Simulation
from pipeline.skeleton.feet.floor import SIDES
from pipeline.skeleton.model import joint_pose

# A true foot stands while its ankle is slower than this speed and closer than this distance to its lowest height; the
# distance allows for a lifted heel.
_STILL_M_S, _LOW_M = 0.05, 0.04
_SHORTEST_S = 0.1
# Tolerance of the start and of the end of a contact.
_TOLERANCE_S = 0.08


def score_feet(
    tracks: Sequence[Track3D], motions: Sequence[SkeletonMotion], simulation: Simulation, joints: JointSet
) -> dict[str, float | None]:
    """Compare the feet of motions with those of the truth.

    Returns
    -------
    foot_slide_cm
        Mean horizontal distance of the ankle from its median position in a true stance, over stances of at least 0.1 s.
    ankle_mm
        Mean error of the ankles over all frames.
    contacts_found
        Share of the frames of true stances that have a contact.
    contacts_invented
        Share of the frames of contacts in which the true foot does not stand, nor within 0.08 s.

    Each figure is ``None`` without data.
    """
    num_frames, rate_hz = simulation.timebase.num_frames, simulation.timebase.frame_rate_hz
    ankles = simulation.joints.indices(tuple(f"{side}_ankle" for side in SIDES))
    truth_m = simulation.truth_m[:, :, ankles]
    stands = standing(truth_m, rate_hz)
    near = _widened(stands, round(_TOLERANCE_S * rate_hz))
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


def _widened(mask: Bool[np.ndarray, "people frames 2"], by: int) -> Bool[np.ndarray, "people frames 2"]:
    wider = mask.copy()
    for shift in range(1, by + 1):
        wider[:, shift:] |= mask[:, :-shift]
        wider[:, :-shift] |= mask[:, shift:]
    return wider


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
