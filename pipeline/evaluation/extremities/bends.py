"""Bends of the fingers' hinges, from positions of joints."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from pipeline.data.animation import Side
from pipeline.data.people import Track3D
from pipeline.joints import JointSet, finger_joints

_SIDES: tuple[Side, ...] = ("left", "right")
# Largest bend backwards of the knuckles and of the hinges of fingers, and of the thumb's hinges, whose axis is known
# less exactly.
_KNUCKLE_DEG, _HINGE_DEG, _THUMB_DEG = -40.0, -5.0, -15.0
# Direction in which the thumb bends: to the little finger and to the palm (radial and palmar components).
_THUMB_BEND = (-0.8, 0.6)


def count_backward_bends(tracks: Sequence[Track3D], joints: JointSet) -> int | None:
    """Count the hinges of fingers that bend backwards, over all frames of all tracks.

    A hinge bends backwards if it is bent by more than 5 degrees to the back of the hand, the thumb's hinges by more
    than 15 degrees, and a knuckle by more than 40 degrees.

    Returns
    -------
        Number of hinges and frames; ``None`` if ``joints`` has no hands.
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

    Parameters
    ----------
    hand_m
        World positions of the wrist and of ``finger_joints``, NaN where a joint is unknown.

    Returns
    -------
        Two hinges of the thumb, four knuckles, and two hinges of each finger; NaN beside unknown joints.
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
