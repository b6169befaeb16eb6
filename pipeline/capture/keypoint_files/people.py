"""People of a frame in keypoint files: their arrays, limits and errors."""

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from pipeline.core.joints import (
    BODY_25,
    BODY_FEET,
    COCO_17,
    COCO_18,
    SIDES,
    WHOLE_BODY,
    JointSet,
    finger_joints,
    hand_bones,
)
from pipeline.core.options.config import MAX_OUTPUT_FRAMES
from pipeline.core.parsing import KEYPOINT_PX, UnreadableError, read_numbers

MAX_PEOPLE = 128
"""Limit on the people of a camera in a frame; association takes some seconds for a frame with so many people."""
# Limit on the people listed in a frame, including people without a detected joint.
_MAX_LISTED_PEOPLE = 1000
# Lowest score of a detected joint: far below the scores of detectors, far above numbers whose squares are 0.
_MIN_SCORE = 1e-9

_END_OF_NUMBERS = 10**15
_LAST_NUMBER = re.compile(r"(?<![0-9])([0-9]{1,15})[^0-9]*$")
_MAX_NAME = 255

NUM_HAND_POINTS = 21
"""Points of a hand in all formats, the wrist first, which is the body's."""

People = Float[np.ndarray, "_ _ 3"]
"""People of a frame, their joints, and x, y and score; no joints either if the file lists no person."""


def _with_hands(body: JointSet) -> JointSet:
    """Joints of a body, then the fingers of the left and of the right hand."""
    if body == BODY_FEET:
        return WHOLE_BODY
    fingers, bones = map(finger_joints, SIDES), map(hand_bones, SIDES)
    return JointSet((*body.names, *sum(fingers, ())), (*body.bones, *sum(bones, ())))


_BODIES = (BODY_25, COCO_18, COCO_17, BODY_FEET)
_WHOLE: Mapping[int, JointSet] = {len(body.names): _with_hands(body) for body in _BODIES}
JOINT_SETS: Mapping[int, JointSet] = {len(joints.names): joints for joints in (*_BODIES, *_WHOLE.values())}
"""Joint sets of keypoint files by their number of joints, which differ."""


class KeypointsError(Exception):
    """The file can't be used; the text is the message of its problem.

    Parameters
    ----------
    message
        Message of the problem.
    field
        Name of the field in question; ``None`` if there is none.

    Examples
    --------
    >>> error = KeypointsError("A person has 3 points.", "points")
    >>> str(error), error.field
    ('A person has 3 points.', 'points')
    """

    def __init__(self, message: str, field: str | None = None) -> None:
        super().__init__(message)
        self.field = field


class CrowdError(Exception):
    """A frame has more people than allowed."""

    def __init__(self, num_people: int) -> None:
        super().__init__(f"{num_people} people")
        self.num_people = num_people


def find_joint_set(counts: set[int]) -> JointSet | None:
    """Joint set of files with these numbers of joints; ``None`` if they differ in more than the hands.

    A file without a hand lists bodies only.
    """
    most = max(counts)
    same = {most} | {count for count, whole in _WHOLE.items() if len(whole.names) == most}
    return JOINT_SETS[most] if counts <= same else None


def frame_number(value: Any, field: str) -> int:
    """Check the number of a frame; raises ``KeypointsError``."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < _END_OF_NUMBERS:
        raise KeypointsError("The number of a frame must be a whole number of at most 15 digits.", field)
    return value


def check_frames(count: int) -> None:
    """Raise ``KeypointsError`` if a file has more frames than any session may have."""
    if count > MAX_OUTPUT_FRAMES:
        raise KeypointsError(f"The file has {count:,} frames; at most {MAX_OUTPUT_FRAMES:,} are allowed.")


def first_entry(content: Any) -> Mapping[str, Any]:
    """First object of a list; empty without one, and for other content."""
    return next((entry for entry in content if isinstance(entry, dict)), {}) if isinstance(content, list) else {}


def number_in_name(name: Any) -> int | None:
    """Last number in the name of a picture, without its ending and folders; ``None`` if it has none.

    >>> number_in_name("labeled-data/cam2/img0012.png"), number_in_name("7.jpg"), number_in_name("cover.jpg")
    (12, 7, None)
    """
    if not isinstance(name, str):
        return None
    stem = re.split(r"[/\\]", name)[-1].rpartition(".")[0] or name
    found = _LAST_NUMBER.search(stem[-_MAX_NAME:])
    return None if found is None else int(found[1])


def is_detected(people: Float[np.ndarray, "*joints 3"]) -> Bool[np.ndarray, "*joints"]:
    """Return which joints were detected: all numbers are finite, and the score is above 0."""
    x, y, score = np.moveaxis(np.isfinite(people), -1, 0)
    return x & y & score & (people[..., 2] >= _MIN_SCORE)


def check_number(listed: Sequence[Any]) -> None:
    """Raise ``CrowdError`` if a frame lists too many people, with or without joints."""
    if len(listed) > _MAX_LISTED_PEOPLE:
        raise CrowdError(len(listed))


def with_detected_joints(people: People) -> People:
    """Check the positions and the number of people, and leave out people without a detected joint.

    Raises ``KeypointsError`` if a detected joint is not within the limits, ``CrowdError`` if there are too many people.
    """
    detected = is_detected(people)
    if not KEYPOINT_PX.holds(people[detected, :2]):
        raise KeypointsError(f"A coordinate of a joint is not within {KEYPOINT_PX}.")
    people = people[detected.any(-1)]
    if len(people) > MAX_PEOPLE:
        raise CrowdError(len(people))
    return people


def read_points(lists: Sequence[Any], num_points: int, field: str) -> Float[np.ndarray, "_ _ 3"]:
    """Convert flat lists of x, y and score, one a person, to points; an empty list or ``None`` is a part unseen.

    Raises ``KeypointsError`` if a list has another length, ``UnreadableError`` if an entry is not a number.
    """
    for numbers in lists:
        if numbers is not None and not isinstance(numbers, list):
            raise UnreadableError
        if numbers and len(numbers) != 3 * num_points:
            raise KeypointsError(
                f"{field} has {len(numbers)} numbers; {num_points} points have {3 * num_points}.", field
            )
    values = read_numbers([numbers or [0.0] * (3 * num_points) for numbers in lists])
    return values.reshape(len(lists), num_points, 3)


def join_hands(lists_of: Callable[[str], Sequence[Any]], field_of: Callable[[str], str]) -> People | None:
    """Fingers of the left and of the right hand, without the wrists; ``None`` if no person has a hand.

    ``lists_of`` gives a list of x, y and score of the points of a side's hand for each person, ``field_of`` the name of
    the field of a side.
    """
    by_side = [lists_of(side) for side in SIDES]
    if not any(any(numbers) for lists in by_side for numbers in lists if numbers):
        return None
    hands = [
        read_points(lists, NUM_HAND_POINTS, field_of(side))[:, 1:] for side, lists in zip(SIDES, by_side, strict=True)
    ]
    return np.concatenate(hands, axis=1)


def joined(body: People, hands: People | None) -> People:
    """Bodies with their hands; the bodies alone if no person has a hand."""
    return body if hands is None else np.concatenate([body, hands], axis=1)


def no_people(num_joints: int = 0) -> People:
    """Empty frame."""
    return np.empty((0, num_joints, 3))
