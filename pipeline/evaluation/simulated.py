"""Accuracy on simulated scenes, whose truth is exact and whole."""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from pipeline.data import Track3D
from pipeline.evaluation.mot import MotFrame, score_mot
from pipeline.evaluation.mpjpe import BODY_JOINTS, GATE_M, accuracy, match_frames, mean_distance_m, select_joints
from pipeline.joints import JointSet
from pipeline.quality.report import bone_length_std_cm, mean_jitter_m_s2
from pipeline.simulation.scenes import Simulation

_WRISTS = [BODY_JOINTS.index(f"{side}_wrist") for side in ("left", "right")]
# A wrist so near to another one's joint touches; one so near to the truth is found.
_TOUCH_M, _HAND_M = 0.25, 0.15


def score_simulated(tracks: Sequence[Track3D], simulation: Simulation, joints: JointSet) -> dict[str, Any]:
    """Score tracks over the twelve joints of the body.

    Parameters
    ----------
    joints
        What the joint axis of the tracks holds.

    Returns
    -------
        ``mpjpe_mm``, ``recall``, ``ghost_rate`` and ``switches`` as of ``metrics.mpjpe``; ``mota`` and ``idf1`` with
        0.5 m as the gate; ``bone_std_cm`` and ``jitter_m_s2`` as of ``metrics.quality``; ``people_correct``, the share
        of frames with as many tracks as people; ``hands_kept``, of frames in which two people touch, the share in which
        both have both wrists within 0.15 m (``None`` where nobody touches); ``mpjpe_by_joint_mm``, left and right
        together, the head's and the neck's beside the twelve.
    """
    frames = np.arange(simulation.timebase.num_frames)
    truth_m = simulation.truth_m[:, :, simulation.joints.indices(BODY_JOINTS)]
    predicted_m = select_joints(tracks, joints, BODY_JOINTS, frames)
    there = np.isfinite(predicted_m).all(-1).any(-1)
    found = accuracy(predicted_m, truth_m)
    error_m = _errors_m(predicted_m, truth_m, match_frames(predicted_m, truth_m))
    mot = score_mot([_mot_frame(truth_m[:, k], predicted_m[:, k]) for k in frames])
    return {
        "mpjpe_mm": found.mpjpe_mm,
        "mota": mot.mota,
        "idf1": mot.idf1,
        "switches": found.switches,
        "bone_std_cm": bone_length_std_cm(tracks, joints) if tracks else None,
        "jitter_m_s2": mean_jitter_m_s2(tracks, simulation.timebase.frame_rate_hz) if tracks else None,
        "people_correct": float(np.mean(there.sum(0) == simulation.present.sum(0))),
        "recall": found.recall,
        "ghost_rate": found.ghost_rate,
        "hands_kept": _hands_kept(error_m, truth_m),
        "mpjpe_by_joint_mm": _by_joint_mm(tracks, simulation, joints, match_frames(predicted_m, truth_m)),
    }


def _errors_m(
    predicted_m: Float[np.ndarray, "tracks frames joints 3"],
    truth_m: Float[np.ndarray, "people frames joints 3"],
    matched: Int[np.ndarray, "people frames"],
) -> Float[np.ndarray, "people frames joints"]:
    """Distance of each joint to that of the person's match; NaN where there is none."""
    nobody = np.full((1, *predicted_m.shape[1:]), np.nan)
    of_match_m = np.concatenate([predicted_m, nobody])[matched, np.arange(truth_m.shape[1])]
    return np.linalg.norm(of_match_m - truth_m, axis=-1)


def _by_joint_mm(
    tracks: Sequence[Track3D], simulation: Simulation, joints: JointSet, matched: Int[np.ndarray, "people frames"]
) -> dict[str, float | None]:
    """Mean error of each kind of joint (table 2 of Chen et al. 2020); the true neck is between the shoulders."""
    names = ("nose", "neck", *BODY_JOINTS)
    body_m = simulation.truth_m[:, :, simulation.joints.indices(("nose", *BODY_JOINTS))]
    truth_m = np.insert(body_m, 1, body_m[:, :, 1:3].mean(2), axis=2)
    predicted_m = select_joints(tracks, joints, names, np.arange(simulation.timebase.num_frames))
    error_m = _errors_m(predicted_m, truth_m, matched)
    kinds = [name.rpartition("_")[2] for name in names]
    return {
        kind: float(np.nanmean(mine)) * 1000 if np.isfinite(mine).any() else None
        for kind in dict.fromkeys(kinds)
        for mine in [error_m[..., np.array([other == kind for other in kinds])]]
    }


def _hands_kept(
    error_m: Float[np.ndarray, "people frames joints"], truth_m: Float[np.ndarray, "people frames joints 3"]
) -> float | None:
    """Share of frames of touching pairs in which both have both wrists."""
    has_both = np.asarray((error_m[..., _WRISTS] <= _HAND_M).all(-1))
    num_kept = num_touching = 0
    for one, other in itertools.combinations(range(len(truth_m)), 2):
        apart_m = [
            np.linalg.norm(truth_m[a][:, _WRISTS, None] - truth_m[b][:, None], axis=-1)
            for a, b in ((one, other), (other, one))
        ]
        touching = np.nanmin(np.where(np.isnan(apart_m), np.inf, apart_m), axis=(0, 2, 3)) < _TOUCH_M
        num_touching += int(touching.sum())
        num_kept += int((touching & has_both[one] & has_both[other]).sum())
    return num_kept / num_touching if num_touching else None


def _mot_frame(truth_m: np.ndarray, predicted_m: np.ndarray) -> MotFrame:
    """One frame; the similarity of a pair at the gate is 0.5, where ``trackeval`` draws the line."""
    people = np.flatnonzero(np.isfinite(truth_m).all(-1).any(-1))
    tracks = np.flatnonzero(np.isfinite(predicted_m).all(-1).any(-1))
    distance_m = mean_distance_m(predicted_m[tracks], truth_m[people])
    return MotFrame(people, tracks, np.maximum(0.0, 1.0 - distance_m / (2 * GATE_M)))
