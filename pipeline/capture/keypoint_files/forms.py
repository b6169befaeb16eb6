"""Forms of keypoint files: the reader of a file, found by its content."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from pipeline.capture.keypoint_files import (
    alphapose,
    coco,
    deeplabcut,
    easymocap,
    freemocap,
    mediapipe,
    mmpose,
    openpose,
    yolo,
)
from pipeline.capture.keypoint_files.hdf5 import tracks
from pipeline.capture.keypoint_files.people import KeypointsError, People
from pipeline.capture.keypoint_files.points import UnnamedPoints


class KeypointForm(NamedTuple):
    """Form of a file, with the functions of its reader.

    Both raise ``TypeError``, ``KeyError`` or ``UnreadableError`` if the content is not in the format, and
    ``KeypointsError`` if it can't be used, such as for a frame without a number or with the number of another one.
    ``read_frame`` raises ``CrowdError`` if there are too many people.
    """

    name: str  # Program or format, as users know it
    # Reads the people of a frame from the content of its file, or from an entry of ``split_frames``
    read_frame: Callable[[Any], People]
    # Splits the content of a file of all frames by their numbers; ``None`` if the content is of a single frame
    split_frames: Callable[[Any], Mapping[int, Any]] | None


OPENPOSE, EASYMOCAP = "OpenPose", "EasyMocap"
# Fields of the people in an object, which tell its program.
_FIELDS = {
    "annotations": "COCO",
    easymocap.PEOPLE: EASYMOCAP,
    "instance_info": "MMPose",
    **dict.fromkeys(("poses", *mediapipe.RESULTS), "MediaPipe"),
    "bodies": "AlphaPose",
    "people": OPENPOSE,
}


def find_form(content: Any, size_px: tuple[int, int] | None, unnamed: UnnamedPoints) -> KeypointForm:
    """Find the form of a file's content.

    ``content`` is parsed JSON, the bytes of a CSV file, YOLO's labels, an array, or the people of an HDF5 file.
    ``size_px`` has width and height of the camera's images; ``None`` if unknown. ``unnamed`` gives the layouts of
    points that files do not name. Unknown JSON is taken as OpenPose's.
    Raises ``KeypointsError`` if a CSV file is of no known form, or if JSON has the fields of several.
    """
    match content:
        case bytes():
            if not deeplabcut.is_table(content):
                raise KeypointsError("The CSV file does not begin with the row scorer of DeepLabCut.")
            return KeypointForm("DeepLabCut", deeplabcut.read_frame, deeplabcut.split_frames)
        case yolo.PoseLabels():
            return KeypointForm("YOLO", partial(yolo.read_frame, size_px=size_px, unnamed=unnamed), None)
        case tracks.PeopleByFrame():
            return KeypointForm(content.form, tracks.read_frame, tracks.split_frames)
        case np.ndarray():
            return KeypointForm("FreeMoCap", partial(freemocap.read_frame, unnamed=unnamed), freemocap.split_frames)
    return _form_of_json(content, size_px, unnamed)


def _form_of_json(content: Any, size_px: tuple[int, int] | None, unnamed: UnnamedPoints) -> KeypointForm:
    if isinstance(content, list):
        return _form_of_list(content, size_px, unnamed)
    if isinstance(content, dict):
        return _form_of_object(content, size_px, unnamed)
    return KeypointForm(OPENPOSE, partial(openpose.read_frame, unnamed=unnamed), None)


def _form_of_list(content: list[Any], size_px: tuple[int, int] | None, unnamed: UnnamedPoints) -> KeypointForm:
    first = next((entry for entry in content if isinstance(entry, dict)), {})
    if "instances" in first:
        return KeypointForm("MMPose", partial(mmpose.read_frame, unnamed=unnamed), mmpose.split_frames)
    if "keypoint_scores" in first:
        return KeypointForm("MMPose", partial(mmpose.read_frame, unnamed=unnamed), None)
    if not first.keys().isdisjoint(mediapipe.RESULTS):
        return KeypointForm("MediaPipe", partial(mediapipe.read_frame, size_px=size_px), mediapipe.split_frames)
    if easymocap.is_person(first):
        return KeypointForm(EASYMOCAP, partial(easymocap.read_frame, unnamed=unnamed), None)
    if isinstance(first.get("image_id"), str):
        return KeypointForm("AlphaPose", partial(alphapose.read_frame, unnamed=unnamed), alphapose.split_frames)
    return KeypointForm("COCO", partial(coco.read_frame, unnamed=unnamed), coco.split_frames)


def _form_of_object(content: dict[str, Any], size_px: tuple[int, int] | None, unnamed: UnnamedPoints) -> KeypointForm:
    of_program = {program: field for field, program in _FIELDS.items() if field in content}
    if len(of_program) > 1:
        shown = " and ".join(f"{field} of {program}" for program, field in of_program.items())
        raise KeypointsError(f"The file has the fields of several formats: {shown}. Keep one of them.")
    if "annotations" in content:
        return KeypointForm("COCO", partial(coco.read_frame, unnamed=unnamed), coco.split_frames)
    if easymocap.PEOPLE in content:
        return KeypointForm(EASYMOCAP, partial(easymocap.read_frame, unnamed=unnamed), None)
    if "instance_info" in content:
        return KeypointForm("MMPose", partial(mmpose.read_frame, unnamed=unnamed), mmpose.split_frames)
    if not content.keys().isdisjoint(("poses", "frames", *mediapipe.RESULTS)):
        split_frames = mediapipe.split_frames if "frames" in content else None
        return KeypointForm("MediaPipe", partial(mediapipe.read_frame, size_px=size_px), split_frames)
    if "bodies" in content or alphapose.is_images(content):
        split_frames = None if "bodies" in content else alphapose.split_frames
        return KeypointForm("AlphaPose", partial(alphapose.read_frame, unnamed=unnamed), split_frames)
    return KeypointForm(OPENPOSE, partial(openpose.read_frame, unnamed=unnamed), None)
