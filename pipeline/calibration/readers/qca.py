"""Qualisys calibration (XML): QCA files, and the parameters that the real-time protocol sends.

Intrinsics are in 1/64 pixel of the sensor, lengths in millimetres. The video is the part ``fov_video`` of the sensor.
The transform holds the camera's centre c and its orientation R with y up and z backwards:
``x_cv = diag(1, -1, -1) R (x - c)``. ``model`` names the hardware. ``viewrotation`` is how Qualisys shows the picture:
videos are stored without it.

Pose2Sim converts both ways between QCA and its TOML, and counts the distortion in 64ths there, too, though it has no
unit. The distortion is right after both ways, 64 times too large in a QCA file of a camera that a board calibrated, and
a 64th in a TOML file of a Qualisys camera. ``is_64th`` tells by the decimals.

Rows of the table of formats:

| Qualisys QCA | `.qca`, `.xml`, or `<` as the first character; root element `calibration`, alone or in
`QTM_Parameters_Ver_...` | mm | Z up; the principal point is moved to the part `fov_video` of the sensor |
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np

from pipeline.calibration.contents import CameraFile
from pipeline.calibration.formats import reader
from pipeline.calibration.readers.xml_files import read_number, read_root, video_cameras
from pipeline.calibration.reading import Reading
from pipeline.calibration.validate import MAX_CAMERAS, RawCamera
from pipeline.core.problems.session_codes import CALIBRATION_EMPTY, UNSUPPORTED_LENS

ROOT = "calibration"

_SUBPIXELS = 64.0
# Pose2Sim's attribute ``created``.
_POSE2SIM = "sometimes ago"
# Decimals of a distortion in Qualisys's files.
_NUM_DECIMALS = 6
_CV_FROM_QUALISYS = np.diag([1.0, -1.0, -1.0])
_UNUSED = {"active": {"0", "false"}, "calibrated": {"0", "false"}}


@reader("Qualisys QCA", suffixes=(".qca",), roots=(ROOT, "QTM_Parameters_Ver_*"))
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
    if calibration is not None and calibration.get("created") == _POSE2SIM:
        enlarged = [
            camera.name
            for camera in raw
            if any(camera.distortion) and not is_64th([coefficient / _SUBPIXELS for coefficient in camera.distortion])
        ]
        reading.notes.append(
            f"{reading.file}: Pose2Sim wrote the file. Its picture sizes may be a pixel too large, so the size of the "
            "videos is used."
        )
        reading.note_about(enlarged, "stated by Pose2Sim with 64 times the distortion, which is divided by 64")
        raw = [
            replace(
                camera,
                size_px=[side - 1 for side in camera.size_px],
                distortion=[coefficient / _SUBPIXELS for coefficient in camera.distortion],
            )
            if camera.name in enlarged
            else camera
            for camera in raw
        ]
    return reading.contents("Qualisys QCA", raw, "mm", axes="Z up, as Qualisys calibrates")


def is_64th(distortion: Sequence[float], parts: float = _SUBPIXELS) -> bool:
    """Return whether coefficients are a 64th, or another part, of coefficients that Qualisys wrote."""
    whole = [coefficient * parts for coefficient in distortion]
    return all(map(_is_written, whole)) and not all(map(_is_written, distortion))


def _is_written(coefficient: float) -> bool:
    return coefficient == round(coefficient, _NUM_DECIMALS)


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
