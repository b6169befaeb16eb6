"""Accuracy on simulated scenes, whose truth is exact and whole."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from pipeline.data import Track3D
from pipeline.metrics.mot import MotFrame, score_mot
from pipeline.metrics.mpjpe import BODY_JOINTS, GATE_M, accuracy, mean_distance_m, select_joints
from pipeline.metrics.quality import bone_length_std_cm
from pipeline.simulation.scenes import Simulation


def score_simulated(tracks: Sequence[Track3D], simulation: Simulation) -> dict[str, Any]:
    """Score tracks over the twelve joints of the body.

    Returns
    -------
        ``mpjpe_mm``, ``recall``, ``ghost_rate`` and ``switches`` as of ``metrics.mpjpe``; ``mota`` and ``idf1`` with
        0.5 m as the gate; ``bone_std_cm`` as of ``metrics.quality``; ``people_correct``, the share of frames with as
        many tracks as people.
    """
    frames = np.arange(simulation.timebase.num_frames)
    truth_m = simulation.truth_m[:, :, simulation.joints.indices(BODY_JOINTS)]
    predicted_m = select_joints(tracks, simulation.joints, BODY_JOINTS, frames)
    there = np.isfinite(predicted_m).all(-1).any(-1)
    found = accuracy(predicted_m, truth_m)
    mot = score_mot([_mot_frame(truth_m[:, k], predicted_m[:, k]) for k in frames])
    return {
        "mpjpe_mm": found.mpjpe_mm,
        "mota": mot.mota,
        "idf1": mot.idf1,
        "switches": found.switches,
        "bone_std_cm": bone_length_std_cm(tracks, simulation.joints) if tracks else None,
        "people_correct": float(np.mean(there.sum(0) == simulation.present.sum(0))),
        "recall": found.recall,
        "ghost_rate": found.ghost_rate,
    }


def _mot_frame(truth_m: np.ndarray, predicted_m: np.ndarray) -> MotFrame:
    """One frame; the similarity of a pair at the gate is 0.5, where ``trackeval`` draws the line."""
    people = np.flatnonzero(np.isfinite(truth_m).all(-1).any(-1))
    tracks = np.flatnonzero(np.isfinite(predicted_m).all(-1).any(-1))
    distance_m = mean_distance_m(predicted_m[tracks], truth_m[people])
    return MotFrame(people, tracks, np.maximum(0.0, 1.0 - distance_m / (2 * GATE_M)))
