"""Hands: crops from BlazePose's hand landmarks, and the fingers that the hand network reads in them.

The regions follow MediaPipe's holistic pipeline (Grishchenko and Bazarevsky, 2020) without its network that
recrops.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from pipeline.core.joints import SIDES
from pipeline.detection.topdown.blazepose import LANDMARK
from pipeline.detection.topdown.regions import Region
from pipeline.detection.topdown.regions import upward as upward_angle

CROP_PX = 224
MIN_PALM_PX = 20.0
"""Least length of a palm in pixels of the image: directions of shorter palms are off by tens of degrees."""
_MIN_PRESENCE = 0.5
# Side of the crop in distances from the wrist to the knuckles, and its shift towards the fingers.
_SIDE, _SHIFT = 2 * 1.89, 0.1 * 2
# Largest distance of the hand's wrist from the body's wrist, in lengths of the palm.
_MAX_WRIST_DISTANCE = 0.6
# Hands are the same if their joints are closer on average, in lengths of the palm.
_SAME_DISTANCE = 0.4
# Factor of the score of a hand that looks like the other side's: the network takes one hand in five for the other.
_WRONG_SIDE = 0.7

_NUM_POINTS = 21  # the wrist, then the fingers in the order of pipeline.core.joints.FINGERS
_KNUCKLES = (5, 9, 17)  # of index, middle finger and little finger


@dataclass(frozen=True, slots=True, eq=False)
class Hand:
    """Hand of a body in an image."""

    # Numbers of the body and of the side in ``pipeline.core.joints.SIDES``
    body: int
    side: int
    points_px: Float[np.ndarray, "points 2"]  # Wrist and 20 joints of the fingers in pixels of the image
    score: float  # Confidence in [0, 1]
    palm_px: float  # Length of the palm in pixels of the image
    wrist_distance: float  # Distance of the hand's wrist from the body's wrist, in lengths of the palm


def hand_region(landmarks_px: Float[np.ndarray, "landmarks 2"], side: int) -> Region | None:
    """Region of a hand from BlazePose's landmarks of wrist, index finger and little finger.

    ``None`` for a hand that is too small or has missing landmarks.
    """
    wrist_px, index_px, pinky_px = (
        landmarks_px[LANDMARK[f"{SIDES[side]}_{name}"]] for name in ("wrist", "index", "pinky")
    )
    knuckles_px = (2 * index_px + pinky_px) / 3
    length_px = float(np.linalg.norm(knuckles_px - wrist_px))
    # Foreshortened palms have short crops, but their hands are as large as others.
    if not length_px >= MIN_PALM_PX / 2:
        return None
    center_px = knuckles_px + _SHIFT * (knuckles_px - wrist_px)
    return Region((float(center_px[0]), float(center_px[1])), _SIDE * length_px, upward_angle(knuckles_px - wrist_px))


def decode_hand(
    outputs: Mapping[str, np.ndarray],
    region: Region,
    body: int,
    side: int,
    wrist_px: Float[np.ndarray, " 2"],
) -> Hand | None:
    """Decode the outputs of one crop.

    ``outputs``: ``landmarks``, 21 times x, y and z in pixels of the crop; ``presence`` and ``handedness`` in [0, 1],
    the latter near 1 for right hands. ``body``, ``side``: body and side to which the crop belongs. ``wrist_px``: wrist
    of the body in pixels of the image; NaN if it is missing. Returns the hand, or ``None`` if there is none in the
    crop, if it is too small, or if it does not hang on the wrist.
    """
    presence, right = (float(outputs[name].reshape(())) for name in ("presence", "handedness"))
    crop_points_px = outputs["landmarks"].reshape(_NUM_POINTS, 3)[:, :2].astype(np.float64)
    points_px = region.image_from_crop(crop_points_px, CROP_PX)
    palm_px = palm_length_px(points_px)
    if not (presence > _MIN_PRESENCE and palm_px >= MIN_PALM_PX):
        return None
    distance = float(np.linalg.norm(points_px[0] - wrist_px)) / palm_px
    if not distance <= _MAX_WRIST_DISTANCE:
        return None
    is_expected_side = (right > 0.5) == (SIDES[side] == "right")
    return Hand(body, side, points_px, presence * (1.0 if is_expected_side else _WRONG_SIDE), palm_px, distance)


def palm_length_px(points_px: Float[np.ndarray, "points 2"]) -> float:
    """Length of a palm: the greatest distance from the wrist to a knuckle, or of the outer knuckles."""
    to_knuckles_px = np.linalg.norm(points_px[list(_KNUCKLES)] - points_px[0], axis=-1).max()
    across_px = np.linalg.norm(points_px[_KNUCKLES[0]] - points_px[_KNUCKLES[-1]])
    return float(max(to_knuckles_px, across_px))


def without_doubles(hands: Sequence[Hand]) -> list[Hand]:
    """Hands of an image of which each was seen once: a hand in two crops belongs to the nearer wrist."""
    kept: list[Hand] = []
    for hand in sorted(hands, key=lambda hand: hand.wrist_distance):
        if not any(_are_same(hand, other) for other in kept):
            kept.append(hand)
    return kept


def _are_same(first: Hand, second: Hand) -> bool:
    distance_px = np.linalg.norm(first.points_px - second.points_px, axis=-1).mean()
    return bool(distance_px <= _SAME_DISTANCE * min(first.palm_px, second.palm_px))
