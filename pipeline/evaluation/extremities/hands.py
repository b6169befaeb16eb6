"""Accuracy of fingers on simulated scenes."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from pipeline.data.people import Track3D
from pipeline.evaluation.extremities.bends import count_backward_bends
from pipeline.evaluation.extremities.matching import matched_joints, mean_of
from pipeline.joints import SIDES, JointSet, finger_joints
from pipeline.simulation.scenes import Simulation


def score_hands(tracks: Sequence[Track3D], simulation: Simulation, joints: JointSet) -> dict[str, Any]:
    """Compare fingers of tracks with the truth, relative to the wrist.

    Parameters
    ----------
    joints
        Joints of the tracks.

    Returns
    -------
    finger_mm, finger_p95_mm
        Mean error of the fingers' joints relative to the wrist, and its 95th percentile, in frames in which the hand is
        measured.
    finger_all_mm
        Mean error in all frames in which the track has fingers, measured or not.
    hands_measured
        Share of the true hands and frames in which at least half of the fingers' joints are measured.
    backward_bends
        Number of hinges and frames with a finger bent backwards; see ``bends``.
    finger_by_joint_mm
        Mean error by kind of joint, all fingers and both hands together, in frames in which the hand is measured.

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
        "finger_mm": mean_of(of_measured_mm),
        "finger_p95_mm": float(np.percentile(known_mm, 95)) if known_mm.size else None,
        "finger_all_mm": mean_of(error_mm),
        "hands_measured": mean_of(is_measured[simulation.present].astype(float)),
        "backward_bends": count_backward_bends(tracks, joints),
        "finger_by_joint_mm": {
            kind: mean_of(of_measured_mm[..., kinds == kind]) for kind in dict.fromkeys(kinds.tolist())
        },
    }
