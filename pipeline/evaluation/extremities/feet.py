"""Accuracy of heels, big toes and orientation of feet on simulated scenes.

Exported feet are compared with true feet of which only ankle and toe base are known.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from pipeline.data.animation import SkeletonMotion
from pipeline.data.cameras import Timebase
from pipeline.data.people import Track3D
from pipeline.evaluation.extremities.matching import matched_joints, mean_of
from pipeline.evaluation.simulated_feet import slide_cm, standing
from pipeline.joints import SIDES, JointSet
from pipeline.simulation.scenes import Simulation
from pipeline.skeleton.model import joint_pose

_NAMES = tuple(f"{side}_{part}" for part in ("heel", "big_toe") for side in SIDES)
_SIDES = (("Left", 1.0), ("Right", -1.0))
_ENDS = ("Foot", "FootEnd")


def score_heels_and_toes(
    tracks: Sequence[Track3D], simulation: Simulation, joints: JointSet
) -> dict[str, float | None]:
    """Compare heels and toes of tracks with the truth.

    Returns
    -------
    heel_mm, toe_mm
        Mean error of heels and of big toes.
    heel_slide_cm, toe_slide_cm
        Mean horizontal distance of the heel, and of the big toe, from its median position while the true one stands,
        over stances of at least 0.1 s.
    foot_pitch_deg, foot_heading_deg
        Mean absolute error of the angle between the line from heel to toe and the floor, and of its heading.

    Each figure is ``None`` without data.
    """
    truth_m = simulation.truth_m[:, :, simulation.joints.indices(_NAMES)]
    predicted_m, _ = matched_joints(tracks, simulation, joints, _NAMES)
    rate_hz = simulation.timebase.frame_rate_hz
    error_mm = 1000 * np.linalg.norm(predicted_m - truth_m, axis=-1)
    along, true_along = (points_m[:, :, 2:] - points_m[:, :, :2] for points_m in (predicted_m, truth_m))
    return {
        "heel_mm": mean_of(error_mm[..., :2]),
        "toe_mm": mean_of(error_mm[..., 2:]),
        "heel_slide_cm": slide_cm(predicted_m[:, :, :2], standing(truth_m[:, :, :2], rate_hz), rate_hz),
        "toe_slide_cm": slide_cm(predicted_m[:, :, 2:], standing(truth_m[:, :, 2:], rate_hz), rate_hz),
        "foot_pitch_deg": mean_of(np.abs(pitch_deg(along) - pitch_deg(true_along))),
        "foot_heading_deg": mean_of(np.abs(heading_error_deg(along, true_along))),
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

    Parameters
    ----------
    time_s
        Times of the truth on the session's clock.
    feet_m
        True ankle and toe base of the left and of the right foot.

    Returns
    -------
    foot_heading_spread_deg, foot_heading_spread_90_deg
        Median and 90th percentile of the headings' absolute deviation from their median, outwards positive.
    foot_pitch_spread_deg, foot_pitch_spread_90_deg
        Likewise for the angle to the floor.

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
