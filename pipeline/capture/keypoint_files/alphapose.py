"""Reader of AlphaPose's JSON: a list of the people of all images, or an object of all images.

A person of the list has ``image_id``, the name of the image, whose number is the frame's, and ``keypoints`` with
x, y and score of 17 (COCO), 26 or 136 (Halpe) or 133 (COCO-WholeBody) points. With ``--format cmu`` or ``open``
images have ``bodies`` or ``people`` of 18 joints; with PoseFlow each image has a list of people. Formats:
https://github.com/MVIG-SJTU/AlphaPose (docs/output.md, PoseFlow)
"""

from collections.abc import Mapping
from typing import Any

from pipeline.capture.keypoint_files import openpose
from pipeline.capture.keypoint_files.people import (
    KeypointsError,
    People,
    check_number,
    frame_number,
    nobody,
    number_in_name,
    read_points,
    with_detected_joints,
)
from pipeline.capture.keypoint_files.points import UnnamedPoints, arranged

_POINTS = "keypoints"


def is_images(content: Mapping[str, Any]) -> bool:
    """An object has the people of images by their names."""
    if "people" in content or not content:
        return False
    images = list(content.values())
    if all(isinstance(image, list) for image in images):
        first = next((image[0] for image in images if image), {_POINTS: None})
        return isinstance(first, dict) and _POINTS in first
    return isinstance(images[0], dict) and not images[0].keys().isdisjoint(("people", "bodies"))


def split_frames(content: Any) -> Mapping[int, Any]:
    """Split all images by the numbers in their names."""
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


def read_frame(content: Any, unnamed: UnnamedPoints) -> People:
    """Read the people of an image with at least one detected joint."""
    if isinstance(content, dict):
        bodies = {"people": [{"pose_keypoints_2d": body["joints"]} for body in content.get("bodies", ())]}
        return openpose.read_frame(content if "people" in content else bodies, unnamed)
    check_number(content)
    if not content:
        return nobody()
    people = [person[_POINTS] for person in content]
    layout = unnamed.layout(len(people[0]) // 3, _POINTS)
    return with_detected_joints(arranged(read_points(people, len(layout.points), _POINTS), layout))


def _image_number(name: Any) -> int:
    number = number_in_name(name)
    if isinstance(name, str) and number is None:
        raise KeypointsError(f"The name of the image {name[:40]!r} has no number.", "image_id")
    return frame_number(name if number is None else number, "image_id")
