"""Accuracy of fingers on simulated scenes, and bends of their hinges."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.core.data.animation import Side
from pipeline.core.data.people import Track3D
from pipeline.core.joints import SIDES, JointSet, finger_joints
from pipeline.validation.evaluation.extremities.matching import matched_joints, mean_of
from pipeline.validation.simulation.scenes import Simulation

_SIDES: tuple[Side, ...] = ("left", "right")
# Largest bend backwards of the knuckles and of the hinges of fingers, and of the thumb's hinges, whose axis is known
# less exactly.
_KNUCKLE_DEG, _HINGE_DEG, _THUMB_DEG = -40.0, -5.0, -15.0
# Direction in which the thumb bends: to the little finger and to the palm (radial and palmar components).
_THUMB_BEND = (-0.8, 0.6)


def score_hands(tracks: Sequence[Track3D], simulation: Simulation, joints: JointSet) -> dict[str, Any]:
    """Compare fingers of tracks with the truth, relative to the wrist.

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
        Number of hinges and frames with a finger bent backwards.
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


def count_backward_bends(tracks: Sequence[Track3D], joints: JointSet) -> int | None:
    """Count the hinges of fingers that bend backwards, over all frames of all tracks.

    A hinge bends backwards if it is bent by more than 5 degrees to the back of the hand, the thumb's hinges by more
    than 15 degrees, and a knuckle by more than 40 degrees. Returns the number of hinges and frames; ``None`` if
    ``joints`` has no hands.
    """
    number = 0
    for side in _SIDES:
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

    ``hand_m`` are world positions of the wrist and of ``finger_joints``, NaN where unknown. The bends are those of two
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
