"""Feet of simulated people: whether they stand still when they should, and when only then."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.data import SkeletonMotion, Track3D
from pipeline.evaluation.mpjpe import BODY_JOINTS, match_frames, select_joints
from pipeline.joints import JointSet
from pipeline.simulation.scenes import Simulation
from pipeline.skeleton.feet import SIDES
from pipeline.skeleton.model import joint_pose

# A true foot stands while its ankle moves slower than this and is this close to the lowest that it ever is: its heel
# may lift.
_STILL_M_S, _LOW_M = 0.05, 0.04
_SHORTEST_S = 0.1
# A contact may begin and end so much too early and too late.
_TOLERANCE_S = 0.08


def score_feet(
    tracks: Sequence[Track3D], motions: Sequence[SkeletonMotion], simulation: Simulation, joints: JointSet
) -> dict[str, float | None]:
    """Compare motions' feet with the true ones.

    Returns
    -------
        ``foot_slide_cm``: over all true stances of at least 0.1 s, the ankle's mean horizontal distance from its median
        place in that stance. ``ankle_mm``: the ankles' mean error in all frames. ``contacts_found``: share of the true
        stances' frames in which a contact was found; ``contacts_invented``: share of the found contacts' frames in
        which the true foot does not stand, nor within 0.08 s. ``None`` without any.
    """
    num_frames, rate_hz = simulation.timebase.num_frames, simulation.timebase.frame_rate_hz
    ankles = simulation.joints.indices(tuple(f"{side}_ankle" for side in SIDES))
    truth_m = simulation.truth_m[:, :, ankles]
    stands = _stands(truth_m, rate_hz)
    near = _widened(stands, round(_TOLERANCE_S * rate_hz))
    found_m, contact = _laid_out(motions, num_frames)
    matched = match_frames(
        select_joints(tracks, joints, BODY_JOINTS, np.arange(num_frames)),
        simulation.truth_m[:, :, simulation.joints.indices(BODY_JOINTS)],
    )
    frames = np.arange(num_frames)
    there = matched >= 0
    mine_m = np.where(there[..., None, None], found_m[matched, frames], np.nan)
    touches = contact[matched, frames] & there[..., None]
    return {
        "foot_slide_cm": _slide_cm(mine_m, stands, max(2, round(_SHORTEST_S * rate_hz))),
        "ankle_mm": _mean(1000 * np.linalg.norm(mine_m - truth_m, axis=-1)),
        "contacts_found": _mean(touches[stands & there[..., None]]),
        "contacts_invented": _mean(~near[touches]),
    }


def _mean(values: np.ndarray) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else None


def _stands(truth_m: Float[np.ndarray, "people frames 2 3"], rate_hz: float) -> Bool[np.ndarray, "people frames 2"]:
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
    """Ankles and contacts of all motions on the session's frames; one more, of nobody, for who has no match."""
    ankles_m = np.full((len(motions) + 1, num_frames, 2, 3), np.nan)
    contact = np.zeros((len(motions) + 1, num_frames, 2), dtype=bool)
    for number, motion in enumerate(motions):
        start = motion.start_frame
        for foot, side in enumerate(SIDES):
            ankle_m, _ = joint_pose(motion, f"{side.capitalize()}Foot")
            ankles_m[number, start : start + len(ankle_m), foot] = ankle_m
            for one in motion.contacts:
                if one.side == side:
                    contact[number, start + one.rows.start : start + one.rows.stop, foot] = True
    return ankles_m, contact


def _slide_cm(
    ankles_m: Float[np.ndarray, "people frames 2 3"], stands: Bool[np.ndarray, "people frames 2"], shortest: int
) -> float | None:
    slid_m: list[np.ndarray] = [np.zeros(0)]
    for person, foot in np.ndindex(stands.shape[0], 2):
        borders: Int[np.ndarray, " _"] = np.flatnonzero(
            np.diff(stands[person, :, foot].astype(np.int8), prepend=0, append=0)
        )
        for start, stop in borders.reshape(-1, 2):
            xy_m = ankles_m[person, start:stop, foot, :2]
            xy_m = xy_m[np.isfinite(xy_m).all(-1)]
            if len(xy_m) >= shortest:
                slid_m.append(np.linalg.norm(xy_m - np.median(xy_m, axis=0), axis=-1))
    return _mean(100 * np.concatenate(slid_m))
