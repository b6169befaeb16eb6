"""OptiTrack calibration (``.mcal``, XML of Motive 3.2 and later).

``IntrinsicStandardCameraModel`` holds OpenCV's lens model in pixels, ``Extrinsic`` the camera's centre c in metres and
its orientation R from the camera to the world, with y up and z backwards: ``x_cv = diag(1, -1, -1) R^T (X - c)``.
Motive's world has y up.

Rows of the table of formats:

| OptiTrack | `.mcal` of Motive 3.2 and later, root element `calibrationProfile` | m | y up, turned to Z up; the colour
cameras (`ImagerIndex` 30) by `Serial`; all cameras if there is no colour camera |
"""

from itertools import islice
from typing import Any

import numpy as np

from pipeline.calibration.contents import CameraFile
from pipeline.calibration.formats import reader
from pipeline.calibration.readers.xml_files import read_number, read_root, video_cameras
from pipeline.calibration.reading import Reading
from pipeline.calibration.validate import MAX_CAMERAS, RawCamera

_CV_FROM_CAMERA = np.diag([1.0, -1.0, -1.0])
# From a world with z up to Motive's, whose y points up.
_MOTIVE_FROM_UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
# Attribute ImagerIndex of cameras that film in colour; the others track markers.
_COLOUR = "30"


@reader("OptiTrack", suffixes=(".mcal",), roots=("calibrationProfile",))
def read(content: bytes, file: str) -> CameraFile:
    """Read the colour cameras of a file, or all cameras if none films in colour; ``InputError`` lists all problems."""
    root = read_root(content, file)
    elements = list(root.iterfind("./Calibration/Cameras/Camera"))
    reading = Reading(file)
    colour = video_cameras(elements, _films_colour, "Serial", reading)
    # One camera above the limit suffices to report that there are too many.
    raw = [_raw(element, reading) for element in islice(colour or elements, MAX_CAMERAS + 1)]
    return reading.contents("OptiTrack", raw, "m", axes="y up, turned to Z up")


def _films_colour(element: Any) -> bool:
    properties = element.find("Properties")
    return properties is not None and properties.get("ImagerIndex") == _COLOUR


def _raw(element: Any, reading: Reading) -> RawCamera:
    name = element.get("Serial")

    def number(tag: str, attribute: str) -> float:
        return read_number(element, tag, attribute, name, reading)

    def lens(attribute: str) -> float:
        return number("IntrinsicStandardCameraModel", attribute)

    world_from_camera = np.array([number("Extrinsic", f"OrientMatrix{k}") for k in range(9)]).reshape(3, 3)
    centre_m = np.array([number("Extrinsic", axis) for axis in "XYZ"])
    rotation = _CV_FROM_CAMERA @ world_from_camera.T
    return RawCamera(
        name=name,
        size_px=[number("Attributes", "ImagerPixelWidth"), number("Attributes", "ImagerPixelHeight")],
        matrix=[
            [lens("HorizontalFocalLength"), 0.0, lens("LensCenterX")],
            [0.0, lens("VerticalFocalLength"), lens("LensCenterY")],
            [0.0, 0.0, 1.0],
        ],
        distortion=[lens(attribute) for attribute in ("k1", "k2", "TangentialX", "TangentialY", "k3")],
        rotation=rotation @ _MOTIVE_FROM_UPRIGHT,
        translation_m=-rotation @ centre_m,
    )
