"""Reader of COCO-WholeBody's JSON: a list of people, results or annotations, of one frame or of all frames.

A person has either ``keypoints`` with x, y and score of all 133 points, or ``keypoints`` of COCO's 17 joints and
``foot_kpts`` (6), ``lefthand_kpts`` and ``righthand_kpts`` (21 each); faces are not read. ``frame``, or else
``image_id``, is the number of the frame. Format: https://github.com/jin-s13/COCO-WholeBody (data_format.md)
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pipeline.capture.keypoint_files.people import (
    NUM_HAND_POINTS,
    KeypointsError,
    People,
    check_number,
    frame_number,
    hands_of,
    joined,
    nobody,
    points_of,
    with_detected_joints,
)
from pipeline.joints import BODY_FEET, COCO_17
from pipeline.layouts import LAYOUTS

_BODY, _FEET = "keypoints", "foot_kpts"
_NUM_BODY, _NUM_FEET = len(COCO_17.names), 6
_LAYOUT = LAYOUTS["coco-wholebody-133"]
_NUM_ALL = len(_LAYOUT.points)
# Points of the bodies and feet in the layout, and the first points of the hands.
_BODY_FEET = [_LAYOUT.points.index(name) for name in BODY_FEET.names]
_HANDS = {"left": _NUM_ALL - 2 * NUM_HAND_POINTS, "right": _NUM_ALL - NUM_HAND_POINTS}


def frames_of(content: Any) -> Mapping[int, Any]:
    """Split the people of all frames by the number of the frame; ``images`` names frames that may show nobody.

    Raises
    ------
    KeypointsError
        If a person has no number of a frame.
    TypeError, KeyError
        If the content is not in the format.
    """
    frames: dict[int, list[Any]] = {}
    if isinstance(content, dict):
        frames = {frame_number(image["id"], "id"): [] for image in content.get("images", ())}
    for person in _listed(content):
        field = "frame" if "frame" in person else "image_id"
        frames.setdefault(frame_number(person.get(field), field), []).append(person)
    return frames


def read_frame(content: Any) -> People:
    """Read the people of a frame with at least one detected joint.

    Raises
    ------
    KeypointsError, CrowdError
        If the frame can't be used.
    UnreadableError, TypeError, KeyError
        If the content is not in the format.
    """
    listed = _listed(content)
    check_number(listed)
    if not listed:
        return nobody()
    bodies = [person[_BODY] for person in listed]
    if all(len(body) == 3 * _NUM_ALL for body in bodies):
        points = points_of(bodies, _NUM_ALL, _BODY)
        hands = hands_of(lambda side: [_hand_of(body, side) for body in bodies], lambda _: _BODY)
        return with_detected_joints(joined(points[:, _BODY_FEET], hands))
    if any(len(body) != 3 * _NUM_BODY for body in bodies):
        message = f"The keypoints of people must have {3 * _NUM_BODY} or {3 * _NUM_ALL} numbers, as many for everybody."
        raise KeypointsError(message, _BODY)
    body = points_of(bodies, _NUM_BODY, _BODY)
    feet = points_of([person.get(_FEET) for person in listed], _NUM_FEET, _FEET)
    hands = hands_of(lambda side: [person.get(_hand(side)) for person in listed], _hand)
    return with_detected_joints(joined(np.concatenate([body, feet], axis=1)[:, _BODY_FEET], hands))


def _listed(content: Any) -> Sequence[Any]:
    listed = content["annotations"] if isinstance(content, dict) else content
    if not isinstance(listed, list) or not all(isinstance(person, dict) for person in listed):
        raise TypeError
    return listed


def _hand(side: str) -> str:
    return f"{side}hand_kpts"


def _hand_of(body: Sequence[Any], side: str) -> Sequence[Any]:
    """Numbers of a hand among those of all points."""
    start = 3 * _HANDS[side]
    return body[start : start + 3 * NUM_HAND_POINTS]
