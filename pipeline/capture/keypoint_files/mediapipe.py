"""Reader of MediaPipe's landmarks as JSON: 33 points of each pose, and 21 points of each hand.

MediaPipe itself writes no files; docs/formats.md describes these. An object a frame has ``poses``; an object of all
frames has ``frames``, and each of them ``frame``, its number. ``image_size`` (width, height) says that positions are
shares of the image, as MediaPipe gives them; without it they are pixels.
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
from pipeline.capture.parsing import read_numbers
from pipeline.capture.quantities import SIDE_PX
from pipeline.joints import BODY_FEET
from pipeline.layouts import LAYOUTS

_POSE, _SIZE = "pose_landmarks", "image_size"
_LAYOUT = LAYOUTS["mediapipe-33"]
_NUM_POSE = len(_LAYOUT.points)
_BODY_FEET = [_LAYOUT.points.index(name) for name in BODY_FEET.names]


def frames_of(content: Any) -> Mapping[int, Any]:
    """Split all frames by their numbers.

    Raises
    ------
    KeypointsError
        If a frame has no number, or the number of another one.
    TypeError, KeyError
        If the content is not in the format.
    """
    frames: dict[int, Any] = {}
    size = {_SIZE: content[_SIZE]} if _SIZE in content else {}
    for one in content["frames"]:
        number = frame_number(one["frame"], "frame")
        if number in frames:
            raise KeypointsError(f"Frame {number} is listed twice.", "frame")
        frames[number] = {**size, **one}
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
    poses = content["poses"]
    check_number(poses)
    if not poses:
        return nobody()
    size_px = _size_px(content)
    body = points_of([_flat(pose[_POSE], _POSE) for pose in poses], _NUM_POSE, _POSE)[:, _BODY_FEET]
    hands = hands_of(lambda side: [_flat(pose.get(_hand(side)), _hand(side)) for pose in poses], _hand)
    people = joined(body, hands)
    if size_px is not None:
        # Shares reach from edge to edge of the image, and pixel 0 has its centre half a pixel from the edge.
        people[..., :2] = people[..., :2] * size_px - 0.5
    return with_detected_joints(people)


def _size_px(content: Any) -> np.ndarray | None:
    """Width and height of the image; ``None`` if positions are pixels."""
    if _SIZE not in content:
        return None
    size_px = read_numbers(content[_SIZE])
    if size_px.shape != (2,) or not SIDE_PX.holds(size_px):
        raise KeypointsError(f"{_SIZE} must be the image's width and height, {SIDE_PX}.", _SIZE)
    return size_px


def _flat(landmarks: Sequence[Mapping[str, Any]] | None, field: str) -> list[Any] | None:
    """X, y and score of each landmark in turn; the score is the visibility, 1 where there is none."""
    if not landmarks:
        return None
    if len(landmarks) not in (_NUM_POSE, NUM_HAND_POINTS):
        message = f"{field} has {len(landmarks)} landmarks; a pose has {_NUM_POSE}, a hand has {NUM_HAND_POINTS}."
        raise KeypointsError(message, field)
    return [number for one in landmarks for number in (one["x"], one["y"], one.get("visibility", 1.0))]


def _hand(side: str) -> str:
    return f"{side}_hand_landmarks"
