"""Reader of AlphaPose's JSON: a list of the people of all images, or an object of all images.

A person of the list has ``image_id``, the name of the image, whose number is the frame's, and ``keypoints`` with
x, y and score of 17 (COCO), 26 or 136 (Halpe) or 133 (COCO-WholeBody) points. With ``--format cmu`` or ``open``
images have ``bodies`` or ``people`` of 18 joints; with PoseFlow each image has a list of people. Formats:
https://github.com/MVIG-SJTU/AlphaPose (docs/output.md, PoseFlow)

Rows of the table of formats:

| AlphaPose | all frames: the list `alphapose-results.json`; of PoseFlow, `--format open` and `--format cmu` an object
of images; or `sep-json/` | COCO-17, Halpe-26 and -136, COCO-WholeBody; 18 joints of `open` and `cmu` | a frame without
people has no entry: it counts as dropped |
"""

from collections.abc import Mapping
from typing import Any

from pipeline.capture.keypoint_files.keypoint_reader import reader
from pipeline.capture.keypoint_files.people import (
    KeypointsError,
    People,
    check_number,
    first_entry,
    frame_number,
    no_people,
    number_in_name,
    read_points,
)
from pipeline.capture.keypoint_files.points import KeypointReading
from pipeline.capture.keypoint_files.readers import openpose

_POINTS = "keypoints"


def is_results(content: Any) -> bool:
    """The content has people with the names of their images: a list of people, or an object of images."""
    if not isinstance(content, dict):
        return isinstance(first_entry(content).get("image_id"), str)
    if not content:
        return False
    images = list(content.values())
    if all(isinstance(image, list) for image in images):
        first = next((image[0] for image in images if image), {_POINTS: None})
        return isinstance(first, dict) and _POINTS in first
    return isinstance(images[0], dict) and not images[0].keys().isdisjoint(("people", "bodies"))


def split_frames(content: Any) -> Mapping[int, Any] | None:
    """Split all images by the numbers in their names."""
    if isinstance(content, dict) and "bodies" in content:
        return None
    frames: dict[int, Any] = {}
    names: dict[int, str] = {}
    for name, image in (
        content.items() if isinstance(content, dict) else ((image["image_id"], image) for image in content)
    ):
        number = _image_number(name)
        if names.setdefault(number, name) != name:
            raise KeypointsError(f"{names[number]} and {name} have the same frame number.", "image_id")
        if isinstance(content, dict):
            frames[number] = image
        else:
            frames.setdefault(number, []).append(image)
    return frames


@reader("AlphaPose", is_content=is_results, fields=("bodies",), rank=3, split_frames=split_frames)
def read_frame(content: Any, reading: KeypointReading) -> People:
    """Read the people of an image with at least one detected joint."""
    if isinstance(content, dict):
        bodies = {"people": [{"pose_keypoints_2d": body["joints"]} for body in content.get("bodies", ())]}
        return openpose.read_frame.read(content if "people" in content else bodies, reading)
    check_number(content)
    if not content:
        return no_people()
    people = [person[_POINTS] for person in content]
    layout = reading.layout(len(people[0]) // 3, _POINTS)
    return reading.people(read_points(people, len(layout.points), _POINTS), layout)


def _image_number(name: Any) -> int:
    number = number_in_name(name)
    if isinstance(name, str) and number is None:
        raise KeypointsError(f"The name of the image {name[:40]!r} has no number.", "image_id")
    return frame_number(name if number is None else number, "image_id")
