"""Reader of EasyMocap's JSON: an object a frame with ``annots``, or the list of these alone.

A person has ``keypoints``, x, y and score of each point: 25 in OpenPose's order, to which EasyMocap brings other
networks' points, or another layout's; and ``handl2d`` and ``handr2d`` of 21 points each, the wrist first. A
score below 0 means that the point was not found. Format: https://github.com/zju3dv/EasyMocap
(easymocap/annotator/file_utils.py, doc/dataset.md)

Rows of the table of formats:

| EasyMocap | a frame: `{"annots": [...]}`, or the list alone: the folders of `annots` | BODY_25 and hands; or the other
layouts of OpenPose | people with boxes alone are refused |
"""

from typing import Any

from pipeline.capture.keypoint_files.keypoint_reader import reader
from pipeline.capture.keypoint_files.people import (
    KeypointsError,
    People,
    check_number,
    first_entry,
    join_hands,
    joined,
    no_people,
    read_points,
    with_detected_joints,
)
from pipeline.capture.keypoint_files.points import KeypointReading, arranged
from pipeline.core.joints import without_hands

_PEOPLE, _POINTS = "annots", "keypoints"


def is_people(content: Any) -> bool:
    """The content lists people in this form: their points are lists of numbers."""
    points = first_entry(content).get(_POINTS)
    return isinstance(points, list) and bool(points) and isinstance(points[0], list)


@reader("EasyMocap", is_content=is_people, fields=(_PEOPLE,), rank=2)
def read_frame(content: Any, reading: KeypointReading) -> People:
    """Read the people of a frame with at least one detected joint."""
    listed = content[_PEOPLE] if isinstance(content, dict) else content
    if not isinstance(listed, list):
        raise TypeError
    check_number(listed)
    if not listed:
        return no_people()
    if any(_POINTS not in person for person in listed):
        raise KeypointsError("A person has no keypoints: only boxes were found. Detect keypoints in them.", _POINTS)
    bodies = [_flat(person[_POINTS], _POINTS) for person in listed]
    layout = reading.layout(len(bodies[0]) // 3, _POINTS)
    people = arranged(read_points(bodies, len(layout.points), _POINTS), layout)
    if layout.joints == without_hands(layout.joints):
        hands = join_hands(lambda side: [_flat(person.get(_hand(side)), _hand(side)) for person in listed], _hand)
        people = joined(people, hands)
    return with_detected_joints(people)


def _flat(points: Any, field: str) -> list[Any]:
    """X, y and score of each point in turn; nothing for a part that is missing."""
    if points is None:
        return []
    if not isinstance(points, list) or not all(isinstance(point, list) for point in points):
        raise TypeError
    if any(len(point) != 3 for point in points):
        raise KeypointsError("A point must have x, y and score.", field)
    return [number for point in points for number in point]


def _hand(side: str) -> str:
    return f"hand{side[0]}2d"
