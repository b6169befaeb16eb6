"""Reader of MMPose's JSON, of RTMPose and its other models: ``instances`` of a frame.

The inferencer writes a list of frames with ``frame_id`` and ``instances`` of a video, or the instances of an image; the
demos write an object with ``instance_info``, that list, and ``meta_info``, which names the points. An instance has
``keypoints``, x and y of each point, and ``keypoint_scores``. Format: ``split_instances`` of mmpose.structures, and
https://mmpose.readthedocs.io/en/latest/user_guides/inference.html

Rows of the table of formats:

| MMPose (RTMPose) | all frames: a list of `frame_id` and `instances`, or `instance_info` of the demos; a frame: a list
of instances | COCO-17, Halpe-26 and -136, COCO-WholeBody; or the points that `keypoint_id2name` names | the inferencer
counts frames from 0, the demos from 1: use one of them for all cameras |
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from pipeline.capture.keypoint_files import people
from pipeline.capture.keypoint_files.keypoint_reader import reader
from pipeline.capture.keypoint_files.points import KeypointReading, layout_of_names
from pipeline.core.layouts import KeypointLayout
from pipeline.core.parsing import read_numbers

_POINTS, _SCORES, _NAMES = "keypoints", "keypoint_scores", "keypoint_id2name"


def is_instances(content: Any) -> bool:
    """The content lists frames with instances, or the instances of a frame."""
    return not people.first_entry(content).keys().isdisjoint(("instances", _SCORES))


def split_frames(content: Any) -> Mapping[int, Any] | None:
    """Split all frames by their numbers."""
    layout = None
    if isinstance(content, dict):
        names = _point_names(content.get("meta_info"))
        layout = None if names is None else layout_of_names(names, _NAMES)
        content = content["instance_info"]
    elif "instances" not in people.first_entry(content):
        return None
    people.check_frames(len(content))
    frames: dict[int, Any] = {}
    for frame in content:
        number = people.frame_number(frame["frame_id"], "frame_id")
        if number in frames:
            raise people.KeypointsError(f"Frame {number} is listed twice.", "frame_id")
        frames[number] = _Frame(frame["instances"], layout)
    return frames


@reader("MMPose", is_content=is_instances, fields=("instance_info",), split_frames=split_frames)
def read_frame(content: Any, reading: KeypointReading) -> people.People:
    """Read the people of a frame with at least one detected joint."""
    instances, layout = content if isinstance(content, _Frame) else _Frame(content, None)
    if not isinstance(instances, list):
        raise TypeError
    people.check_number(instances)
    if not instances:
        return people.no_people()
    num_points = len(instances[0][_POINTS])
    for instance in instances:
        if len(instance[_POINTS]) != num_points:
            raise people.KeypointsError("People have different numbers of points.", _POINTS)
        if len(instance[_SCORES]) != num_points:
            message = f"A person has {num_points} points and {len(instance[_SCORES])} scores."
            raise people.KeypointsError(message, _SCORES)
    layout = reading.layout(num_points, _POINTS) if layout is None else layout
    if len(layout.points) != num_points:
        raise people.KeypointsError(f"A person has {num_points} points; the file names {len(layout.points)}.", _POINTS)
    points_px = read_numbers([instance[_POINTS] for instance in instances])
    if points_px.shape != (len(instances), num_points, 2):
        raise people.KeypointsError("A point must have x and y.", _POINTS)
    scores = read_numbers([instance[_SCORES] for instance in instances])
    if scores.shape != (len(instances), num_points):
        raise people.KeypointsError("A score must be a number.", _SCORES)
    return reading.people(np.concatenate([points_px, scores[..., None]], axis=-1), layout)


class _Frame(NamedTuple):
    """Instances of a frame, and the layout of their points if the file names them."""

    instances: Any
    layout: KeypointLayout | None


def _point_names(meta: Any) -> Sequence[str] | None:
    """Names of the points in their order; ``None`` if the file does not name them."""
    if not isinstance(meta, dict) or not isinstance(meta.get(_NAMES), dict):
        return None
    names = meta[_NAMES]
    if any(str(k) not in names for k in range(len(names))):
        raise people.KeypointsError("The points' names must be numbered from 0.", _NAMES)
    return [str(names[str(k)]) for k in range(len(names))]
