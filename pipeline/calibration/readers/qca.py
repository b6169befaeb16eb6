"""Qualisys QCA calibration (XML).

Intrinsics are in 1/64 pixel of the sensor, lengths in millimetres. The video is the part ``fov_video`` of the sensor.
The transform holds the camera's centre c and its orientation R with y up and z backwards:
``x_cv = diag(1, -1, -1) R (x - c)``.
"""

import math
from itertools import islice
from typing import Any

import numpy as np

from pipeline.calibration.contents import CameraFile, in_metres
from pipeline.calibration.readers.xml_files import read_number, read_root
from pipeline.calibration.validate import MAX_CAMERAS, RawCamera, build_cameras
from pipeline.errors import Problem
from pipeline.problem_codes.sessions import UNSUPPORTED_LENS

_SUBPIXELS = 64.0
_CV_FROM_QUALISYS = np.diag([1.0, -1.0, -1.0])


def read(content: bytes, file: str) -> CameraFile:
    """Read the cameras of a QCA file; ``InputError`` lists all its problems."""
    root = read_root(content, file)
    problems: list[Problem] = []
    # One camera above the limit suffices to report that there are too many.
    elements = islice(root.iterfind("./cameras/camera"), MAX_CAMERAS + 1)
    raw = [_raw(element, file, problems) for element in elements]
    return in_metres("Qualisys QCA", build_cameras(raw, file, problems), "mm", axes="Z up, as Qualisys calibrates")


def _raw(element: Any, file: str, problems: list[Problem]) -> RawCamera:
    name = element.get("serial")

    def number(tag: str, attribute: str) -> float:
        return read_number(element, tag, attribute, file, name, problems)

    def intrinsic(attribute: str) -> float:
        return number("intrinsic", attribute)

    if element.get("model") not in {None, "none"} or not math.isclose(intrinsic("skew"), 0.0):
        problems.append(
            Problem(UNSUPPORTED_LENS, "Only the standard lens model without skew is supported.", file=file, camera=name)
        )
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
