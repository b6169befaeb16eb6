"""Accuracy of heels, big toes and orientation of feet on simulated scenes."""

from collections.abc import Sequence

import numpy as np

from pipeline.data.people import Track3D
from pipeline.evaluation.extremities.angles import heading_error_deg, pitch_deg
from pipeline.evaluation.extremities.matching import matched_joints, mean_of
from pipeline.evaluation.simulated_feet import slide_cm, standing
from pipeline.joints import SIDES, JointSet
from pipeline.simulation.scenes import Simulation

_NAMES = tuple(f"{side}_{part}" for part in ("heel", "big_toe") for side in SIDES)


def score_heels_and_toes(
    tracks: Sequence[Track3D], simulation: Simulation, joints: JointSet
) -> dict[str, float | None]:
    """Compare heels and toes of tracks with the truth.

    Parameters
    ----------
    joints
        Joints of the tracks.

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
