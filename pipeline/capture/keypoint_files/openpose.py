"""Reader of OpenPose's JSON: an object a frame with ``people``.

``pose_keypoints_2d`` of a person has x, y and score of 25 (BODY_25), 18 (COCO-18) or 17 (COCO-17) joints;
``hand_left_keypoints_2d`` and ``hand_right_keypoints_2d`` have those of 21 points, the wrist first, or nothing.
Format: https://cmu-perceptual-computing-lab.github.io/openpose/web/html/doc/md_doc_02_output.html
"""

from typing import Any

from pipeline.capture.keypoint_files.people import (
    KeypointsError,
    People,
    check_number,
    hands_of,
    joined,
    nobody,
    with_detected_joints,
)
from pipeline.joints import BODY_25, COCO_17, COCO_18
from pipeline.parsing import read_numbers

_BODY = "pose_keypoints_2d"
_LENGTHS = frozenset(3 * len(joints.names) for joints in (BODY_25, COCO_18, COCO_17))


def read_frame(content: Any) -> People:
    """Read the people of a frame with at least one detected joint of the body."""
    listed = content["people"]
    bodies = [person[_BODY] for person in listed]
    check_number(bodies)
    # People of zeros are dropped as lists: converting hundreds of them to arrays would take milliseconds a frame.
    kept = [row for row, body in enumerate(bodies) if len(body) not in _LENGTHS or any(body)]
    if not kept:
        return nobody(len(bodies[0]) // 3 if bodies else 0)
    values = read_numbers([bodies[row] for row in kept])
    if values.ndim != 2 or values.shape[1] not in _LENGTHS:
        count = values[0].size
        message = f"A person has {count} numbers; BODY_25 has 75, COCO-18 has 54, COCO-17 has 51."
        raise KeypointsError(message, _BODY)
    body = values.reshape(len(kept), -1, 3)
    hands = hands_of(
        lambda side: [listed[row].get(_hand(side)) for row in kept],
        _hand,
    )
    return with_detected_joints(joined(body, hands))


def _hand(side: str) -> str:
    return f"hand_{side}_keypoints_2d"
