"""Reader of MediaPipe's landmarks as JSON: 33 points of each pose, and 21 points of each hand.

MediaPipe writes no files; programs write its results. A frame is a result of the tasks or of the older solutions, in
Python or JavaScript: an object with ``pose_landmarks``, ``poseLandmarks`` or ``landmarks``, the points of each person
or of one; and for the holistic ones of the hands. A list holds all frames, each with its number ``frame``, or in order
from 0. Positions are shares of the image, whose size is ``image_size`` (width, height), or else the camera's.

Multicap's own form (docs/guide/keypoints.md) has ``poses`` in an object a frame, or ``frames`` in an object of all
frames. There positions without ``image_size`` are pixels. Landmarks: https://ai.google.dev/edge/mediapipe/solutions/vision

Rows of the table of formats:

| MediaPipe | a frame: its result, or `{"poses": [...]}`; all frames: a list of results, or `{"frames": [...]}` |
COCO-17, heels and big toes, and hands | programs write its results; positions are shares of `image_size`, or of the
picture in the calibration; hips are some 3 cm lower than by other networks |
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from pipeline.capture.keypoint_files.keypoint_reader import reader
from pipeline.capture.keypoint_files.people import (
    NUM_HAND_POINTS,
    KeypointsError,
    People,
    check_frames,
    check_number,
    first_entry,
    frame_number,
    join_hands,
    joined,
    no_people,
    read_points,
    with_detected_joints,
)
from pipeline.capture.keypoint_files.points import KeypointReading
from pipeline.core.joints import BODY_FEET, SIDES
from pipeline.core.layouts import LAYOUTS
from pipeline.core.parsing import SIDE_PX, read_numbers

_POSE, _SIZE = "pose_landmarks", "image_size"
# Names of the points of the poses in a result.
_RESULTS = (_POSE, "poseLandmarks", "landmarks")
_LAYOUT = LAYOUTS["mediapipe-33"]
_NUM_POSE = len(_LAYOUT.points)
_BODY_FEET = [_LAYOUT.points.index(name) for name in BODY_FEET.names]


def is_frames(content: Any) -> bool:
    """The content has all frames."""
    return "frames" in content if isinstance(content, dict) else not first_entry(content).keys().isdisjoint(_RESULTS)


def split_frames(content: Any) -> Mapping[int, Any] | None:
    """Split all frames by their numbers."""
    if not is_frames(content):
        return None
    listed = content["frames"] if isinstance(content, dict) else content
    check_frames(len(listed))
    size = {_SIZE: content[_SIZE]} if isinstance(content, dict) and _SIZE in content else {}
    frames: dict[int, Any] = {}
    for place, entry in enumerate(listed):
        is_own = isinstance(content, dict) and entry.keys().isdisjoint(_RESULTS)
        result = {_RESULTS[0]: None} if entry is None else entry
        number = frame_number(entry["frame"] if is_own else result.get("frame", place), "frame")
        if number in frames:
            raise KeypointsError(f"Frame {number} is listed twice.", "frame")
        frames[number] = {**size, **result}
    return frames


@reader("MediaPipe", is_content=is_frames, fields=("poses", *_RESULTS), rank=1, split_frames=split_frames)
def read_frame(content: Any, reading: KeypointReading) -> People:
    """Read the people of a frame with at least one detected joint."""
    scale_px = _size_px(content)
    poses = content.get("poses")
    if poses is None:
        poses = _list_poses(content)
        scale_px = np.array(reading.size_px) if scale_px is None and reading.size_px is not None else scale_px
        if scale_px is None:
            message = f"Landmarks are shares of an image whose size is unknown; add {_SIZE}, its width and height."
            raise KeypointsError(message, _SIZE)
    check_number(poses)
    if not poses:
        return no_people()
    body = read_points([_flat(pose[_POSE], _POSE) for pose in poses], _NUM_POSE, _POSE)[:, _BODY_FEET]
    hands = join_hands(lambda side: [_flat(pose.get(_hand(side)), _hand(side)) for pose in poses], _hand)
    people = joined(body, hands)
    if scale_px is not None:
        # Shares reach from edge to edge of the image, and pixel 0 has its centre half a pixel from the edge.
        people[..., :2] = people[..., :2] * scale_px - 0.5
    return with_detected_joints(people)


def _list_poses(result: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Points of each person in a result: the pose, and hands if there are as many as poses."""
    field = next((name for name in _RESULTS if name in result), None)
    if field is None:
        raise TypeError
    poses = _list_people(result[field])
    check_number(poses)
    people = [{_POSE: pose} for pose in poses]
    for side in SIDES:
        name = _hand(side) if _hand(side) in result else f"{side}HandLandmarks"
        hands = _list_people(result.get(name))
        if hands and len(hands) != len(poses):
            raise KeypointsError(f"There are {len(hands)} {side} hands of {len(poses)} poses.", name)
        for person, hand in zip(people, hands, strict=False):
            person[_hand(side)] = hand
    return people


def _list_people(landmarks: Any) -> list[Any]:
    """Landmarks of each person: of several, of one, or as the older solutions in Python give one person's."""
    if isinstance(landmarks, dict):
        landmarks = landmarks["landmark"]
    if not landmarks:
        return []
    if not isinstance(landmarks, list):
        raise TypeError
    return landmarks if isinstance(landmarks[0], list) else [landmarks]


def _size_px(content: Any) -> np.ndarray | None:
    """Width and height of the image; ``None`` if positions are pixels."""
    if _SIZE not in content:
        return None
    size_px = read_numbers(content[_SIZE])
    if size_px.shape != (2,) or not SIDE_PX.holds(size_px):
        raise KeypointsError(f"{_SIZE} must be the image's width and height, {SIDE_PX}.", _SIZE)
    return size_px


def _flat(landmarks: Any, field: str) -> list[Any] | None:
    """X, y and score of each landmark in turn; the score is the visibility, 1 where there is none."""
    if not landmarks:
        return None
    if len(landmarks) not in (_NUM_POSE, NUM_HAND_POINTS):
        message = f"{field} has {len(landmarks)} landmarks; a pose has {_NUM_POSE}, a hand has {NUM_HAND_POINTS}."
        raise KeypointsError(message, field)
    return [
        number for landmark in landmarks for number in (landmark["x"], landmark["y"], landmark.get("visibility", 1.0))
    ]


def _hand(side: str) -> str:
    return f"{side}_hand_landmarks"
