"""Reader of COCO's JSON: a list of people, results or annotations, of one frame or of all frames.

A person has ``keypoints`` with x, y and score (or visibility) of each point: COCO's 17, COCO-WholeBody's 133, or points
that the ``categories`` of annotations name. With 17 points, ``foot_kpts`` (6), ``lefthand_kpts`` and
``righthand_kpts`` (21 each) may stand beside them; faces are not read. ``frame``, or else ``image_id``, is the number
of the frame; if all ``images`` have files with numbers in their names, these are the numbers. Formats:
https://cocodataset.org/#format-data, https://github.com/jin-s13/COCO-WholeBody (data_format.md)

Rows of the table of formats:

| COCO, COCO-WholeBody | a frame or all frames: a list of people (results), or `{"annotations": [...]}` | COCO-17, heels
and big toes, and hands; or the points that `categories` name | `frame`, or else `image_id`, is the number of the frame,
unless the `file_name` of all images have numbers; faces and small toes are not read |
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from pipeline.capture.keypoint_files.keypoint_reader import reader
from pipeline.capture.keypoint_files.people import (
    KeypointsError,
    People,
    check_number,
    frame_number,
    join_hands,
    joined,
    no_people,
    number_in_name,
    read_points,
    with_detected_joints,
)
from pipeline.capture.keypoint_files.points import KeypointReading, layout_of_names, match_joint
from pipeline.core.joints import BODY_FEET, COCO_17
from pipeline.core.layouts import LAYOUTS, KeypointLayout

_BODY, _FEET = "keypoints", "foot_kpts"
_NUM_BODY, _NUM_FEET = len(COCO_17.names), 6
_WHOLE = LAYOUTS["coco-wholebody-133"]
_BODY_FEET = [_WHOLE.points.index(name) for name in BODY_FEET.names]


def is_frame(content: Any) -> bool:
    """True if a file lists people without their frames: they are in one frame."""
    return isinstance(content, list) and bool(content) and not any({"frame", "image_id"} & set(one) for one in content)


def split_frames(content: Any) -> Mapping[int, Any]:
    """Split the people of all frames by the number of the frame; ``images`` names frames that may show no person."""
    frames: dict[int, list[Any]] = {}
    numbers: Mapping[Any, int] = {}
    if isinstance(content, dict):
        numbers = _image_numbers(content.get("images", ()))
        frames = {number: [] for number in numbers.values()}
    listed, layout, is_named = _list_people(content)
    for person in listed:
        field = "frame" if "frame" in person else "image_id"
        value = person.get(field)
        if field == "image_id" and isinstance(value, int):
            value = numbers.get(value, value)
        frames.setdefault(frame_number(value, field), []).append(person)
    return {number: _Frame(people, layout, is_named) for number, people in frames.items()}


@reader(
    "COCO",
    is_content=lambda content: isinstance(content, list),
    fields=("annotations",),
    rank=4,
    split_frames=split_frames,
    is_frame=is_frame,
)
def read_frame(content: Any, reading: KeypointReading) -> People:
    """Read the people of a frame with at least one detected joint."""
    listed, layout, is_named = content if isinstance(content, _Frame) else _list_people(content)
    check_number(listed)
    if not listed:
        return no_people()
    bodies = [person[_BODY] for person in listed]
    if layout is not None:
        return reading.people(read_points(bodies, len(layout.points), _BODY), layout)
    if all(len(body) == 3 * len(_WHOLE.points) for body in bodies):
        if not is_named:
            reading.layout(len(_WHOLE.points), _BODY)
        return reading.people(read_points(bodies, len(_WHOLE.points), _BODY), _WHOLE)
    if any(len(body) != 3 * _NUM_BODY for body in bodies):
        message = (
            f"The keypoints of people must have {3 * _NUM_BODY} or {3 * len(_WHOLE.points)} numbers, as many for "
            "everybody; of other points, the categories must have names."
        )
        raise KeypointsError(message, _BODY)
    if not is_named:
        reading.layout(_NUM_BODY, _BODY)
    body = read_points(bodies, _NUM_BODY, _BODY)
    feet = read_points([person.get(_FEET) for person in listed], _NUM_FEET, _FEET)
    hands = join_hands(lambda side: [person.get(_hand(side)) for person in listed], _hand)
    return with_detected_joints(joined(np.concatenate([body, feet], axis=1)[:, _BODY_FEET], hands))


class _Frame(NamedTuple):
    """People of a frame, the layout of their points if it is not COCO's, and whether the file names them."""

    people: Sequence[Any]
    layout: KeypointLayout | None
    is_named: bool


def _list_people(content: Any) -> _Frame:
    """People of a file: all of a list; of annotations those whose category has points."""
    listed = content["annotations"] if isinstance(content, dict) else content
    if not isinstance(listed, list) or not all(isinstance(person, dict) for person in listed):
        raise TypeError
    categories = content.get("categories", ()) if isinstance(content, dict) else ()
    names = {category["id"]: tuple(map(str, category[_BODY])) for category in categories if category.get(_BODY)}
    if not names:
        return _Frame(listed, None, is_named=False)
    people = [person for person in listed if person.get("category_id") in names]
    used = {names[person["category_id"]] for person in people}
    if len(used) > 1:
        raise KeypointsError("People of several categories have points of different names.", "category_id")
    found = next(iter(used), COCO_17.names)
    is_coco = (
        len(found) in (_NUM_BODY, len(_WHOLE.points)) and tuple(map(match_joint, found[:_NUM_BODY])) == COCO_17.names
    )
    return _Frame(people, None if is_coco else layout_of_names(found, "categories"), is_named=True)


def _image_numbers(images: Sequence[Mapping[str, Any]]) -> Mapping[Any, int]:
    """Frame number by the id of its image: of the names of files if all have one of their own, else the ids."""
    ids = [frame_number(image["id"], "id") for image in images]
    named = [number_in_name(image.get("file_name")) for image in images]
    is_named = None not in named and len(set(named)) == len(set(ids))
    return {
        image_id: number if is_named and number is not None else image_id
        for image_id, number in zip(ids, named, strict=True)
    }


def _hand(side: str) -> str:
    return f"{side}hand_kpts"
