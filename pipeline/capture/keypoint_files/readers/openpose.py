"""Reader of OpenPose's JSON: an object a frame with ``people``, which other programs write, too.

``pose_keypoints_2d`` of a person has x, y and score of 25 (BODY_25, BODY_25B), 18 (COCO-18) or 17 (COCO-17) points;
``hand_left_keypoints_2d`` and ``hand_right_keypoints_2d`` have 21 points, the wrist first, or nothing.
Pose2Sim puts the points of RTMPose in ``pose_keypoints_2d``, in their own order: 17, 26 (Halpe) or 133
(COCO-WholeBody, with hands); a person that a camera does not see is an empty object or has an empty list. Formats:
https://cmu-perceptual-computing-lab.github.io/openpose/web/html/doc/md_doc_02_output.html,
https://github.com/perfanalytics/pose2sim (poseEstimation.py, personAssociation.py)

Rows of the table of formats:

| OpenPose | a frame: `{"people": [...]}` | BODY_25, COCO-18 or COCO-17, and hands | `pose_keypoints_2d` and the hands
of a person are read; faces are not |
| Pose2Sim, with RTMPose by RTMLib | a frame in the form of OpenPose: the folders `cam01_json` of `pose`, `pose-sync` or
`pose-associated` | COCO-17, Halpe-26, COCO-WholeBody | a person `{}` is not seen by this camera |
"""

from typing import Any

from pipeline.capture.keypoint_files.keypoint_reader import reader
from pipeline.capture.keypoint_files.people import (
    KeypointsError,
    People,
    check_number,
    join_hands,
    joined,
    no_people,
    with_detected_joints,
)
from pipeline.capture.keypoint_files.points import CANDIDATES, KeypointReading, arranged
from pipeline.core.joints import without_hands
from pipeline.core.layouts import FILE_LAYOUTS
from pipeline.core.parsing import read_numbers

_BODY = "pose_keypoints_2d"


@reader("OpenPose", fields=("people",), rank=5)
def read_frame(content: Any, reading: KeypointReading) -> People:
    """Read the people of a frame with at least one detected joint of the body."""
    listed = [person for person in content["people"] if person != {} and person[_BODY] != []]
    bodies = [person[_BODY] for person in listed]
    check_number(bodies)
    if not bodies:
        return no_people()
    num_points, num_more = divmod(len(bodies[0]), 3)
    if num_more or num_points not in CANDIDATES:
        known = ", ".join(f"{layout.name} has {3 * len(layout.points)}" for layout in FILE_LAYOUTS.values())
        raise KeypointsError(f"A person has {len(bodies[0])} numbers; {known}.", _BODY)
    layout = reading.layout(num_points, _BODY)
    # People of zeros are dropped as lists: converting hundreds of them to arrays would take milliseconds a frame.
    kept = [row for row, body in enumerate(bodies) if len(body) != 3 * len(layout.points) or any(body)]
    if not kept:
        return no_people(len(without_hands(layout.joints).names))
    values = read_numbers([bodies[row] for row in kept])
    if values.shape != (len(kept), 3 * len(layout.points)):
        raise KeypointsError(
            f"A person must have x, y and score of {len(layout.points)} points, like the others.", _BODY
        )
    people = arranged(values.reshape(len(kept), -1, 3), layout)
    if layout.joints == without_hands(layout.joints):
        people = joined(people, join_hands(lambda side: [listed[row].get(_hand(side)) for row in kept], _hand))
    return with_detected_joints(people)


def _hand(side: str) -> str:
    return f"hand_{side}_keypoints_2d"
