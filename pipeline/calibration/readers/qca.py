"""Qualisys calibration (XML): QCA files, and the parameters that the real-time protocol sends.

Intrinsics are in 1/64 pixel of the sensor, lengths in millimetres. The video is the part ``fov_video`` of the sensor.
The transform holds the camera's centre c and its orientation R with y up and z backwards:
``x_cv = diag(1, -1, -1) R (x - c)``. ``model`` names the hardware. ``viewrotation`` is how Qualisys shows the picture:
videos are stored without it.
"""

import math
from itertools import islice
from typing import Any

import numpy as np

from pipeline.calibration.contents import CameraFile
from pipeline.calibration.readers.xml_files import read_number, read_root, video_cameras
from pipeline.calibration.reading import Reading
from pipeline.calibration.validate import MAX_CAMERAS, RawCamera
from pipeline.problem_codes.sessions import CALIBRATION_EMPTY, UNSUPPORTED_LENS

ROOT = "calibration"

_SUBPIXELS = 64.0
_CV_FROM_QUALISYS = np.diag([1.0, -1.0, -1.0])
_UNUSED = {"active": {"0", "false"}, "calibrated": {"0", "false"}}


def read(content: bytes, file: str) -> CameraFile:
    """Read the video cameras of a file; ``InputError`` lists all its problems."""
    root = read_root(content, file)
    # The protocol wraps the calibration in its parameters.
    calibration = root if root.tag == ROOT else root.find(f"./{ROOT}")
    elements = [] if calibration is None else calibration.findall("./cameras/camera")
    reading = Reading(file)
    videos = video_cameras(elements, _films_video, "serial", reading)
    serving = [element for element in videos if not _is_unused(element)]
    reading.leave_out([element.get("serial") for element in videos if _is_unused(element)], "not calibrated")
    if elements and not serving:
        message = "No camera of the file films video and is calibrated."
        hint = "Switch cameras to video in Qualisys Track Manager, calibrate, and export the calibration again."
        reading.complain(CALIBRATION_EMPTY, message, hint=hint)
    turned = [element.get("serial") for element in serving if element.get("viewrotation", "0") != "0"]
    reading.note_about(turned, "turned in Qualisys's views; the video is taken as it is stored, not turned")
    # One camera above the limit suffices to report that there are too many.
    raw = [_raw(element, reading) for element in islice(serving, MAX_CAMERAS + 1)]
    return reading.contents("Qualisys QCA", raw, "mm", axes="Z up, as Qualisys calibrates")


def _films_video(element: Any) -> bool:
    """Return whether the video has an area; cameras that track markers have none, or one of a single pixel."""
    fov = element.find("fov_video")
    if fov is None:
        return False
    return all(fov.get(start) != fov.get(end) for start, end in (("left", "right"), ("top", "bottom")))


def _is_unused(element: Any) -> bool:
    return any(element.get(attribute, "").strip().lower() in values for attribute, values in _UNUSED.items())


def _raw(element: Any, reading: Reading) -> RawCamera:
    name = element.get("serial")

    def number(tag: str, attribute: str) -> float:
        return read_number(element, tag, attribute, name, reading)

    def intrinsic(attribute: str) -> float:
        return number("intrinsic", attribute)

    if not math.isclose(intrinsic("skew"), 0.0):
        reading.complain(UNSUPPORTED_LENS, "A lens with skew is not supported.", name, "skew")
    rotation = np.array([[number("transform", f"r{row}{column}") for column in (1, 2, 3)] for row in (1, 2, 3)])
    center_mm = np.array([number("transform", axis) for axis in "xyz"])
    cv_from_world = _CV_FROM_QUALISYS @ rotation
    left, top = number("fov_video", "left"), number("fov_video", "top")
    return RawCamera(
        name=name,
        size_px=[
            number("fov_video", "right") - left + 1,
            number("fov_video", "bottom") - top + 1,
        ],
        matrix=[
            [intrinsic("focalLengthU") / _SUBPIXELS, 0.0, intrinsic("centerPointU") / _SUBPIXELS - left],
            [0.0, intrinsic("focalLengthV") / _SUBPIXELS, intrinsic("centerPointV") / _SUBPIXELS - top],
            [0.0, 0.0, 1.0],
        ],
        distortion=[
            intrinsic(attribute)
            for attribute in (
                "radialDistortion1",
                "radialDistortion2",
                # The misspelling is part of the format.
                "tangentalDistortion1",
                "tangentalDistortion2",
                "radialDistortion3",
            )
        ],
        rotation=cv_from_world,
        translation_m=-cv_from_world @ center_mm,
    )
