"""COLMAP's text model: ``cameras.txt`` and ``images.txt``, in a zip or one after the other in a file.

Each image is a camera: its name is the image's, without the ending. COLMAP's pixel (0, 0) is the outer corner of the
first pixel, half a pixel from its centre. Scale and axes of a reconstruction are arbitrary.

Rows of the table of formats:

| COLMAP text | `.zip` with `cameras.txt` and `images.txt`; or a text file with both, one after the other | `units` |
arbitrary: scale and turn the model first; a camera has the name of its image, or of the image's folder |
"""

from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from pipeline.calibration.contents import CameraFile
from pipeline.calibration.formats import reader
from pipeline.calibration.readers.fields import quaternion_matrix
from pipeline.calibration.reading import Reading
from pipeline.calibration.validate import MAX_CAMERAS, RawCamera
from pipeline.core.errors import InputError
from pipeline.core.parsing import UnreadableError
from pipeline.core.problems.session_codes import CALIBRATION_UNREADABLE, UNSUPPORTED_LENS

CAMERAS_HEAD = "CAMERA_ID, MODEL, WIDTH, HEIGHT"
IMAGES_HEAD = "IMAGE_ID, QW, QX, QY, QZ"

# Positions of fx, fy, cx, cy in the parameters, and number of distortion coefficients in OpenCV's order behind them.
_MODELS: Mapping[str, tuple[tuple[int, int, int, int], int]] = {
    "SIMPLE_PINHOLE": ((0, 0, 1, 2), 0),
    "PINHOLE": ((0, 1, 2, 3), 0),
    "SIMPLE_RADIAL": ((0, 0, 1, 2), 1),
    "RADIAL": ((0, 0, 1, 2), 2),
    "OPENCV": ((0, 1, 2, 3), 4),
    "FULL_OPENCV": ((0, 1, 2, 3), 8),
    "SIMPLE_FISHEYE": ((0, 0, 1, 2), 0),
    "FISHEYE": ((0, 1, 2, 3), 0),
    "SIMPLE_RADIAL_FISHEYE": ((0, 0, 1, 2), 1),
    "RADIAL_FISHEYE": ((0, 0, 1, 2), 2),
    "OPENCV_FISHEYE": ((0, 1, 2, 3), 4),
}
_MIN_COEFFICIENTS = 4
_NUM_CAMERA_WORDS, _NUM_IMAGE_WORDS = 4, 10


def is_text(content: bytes) -> bool:
    """Return whether a file contains both parts, one after the other."""
    return CAMERAS_HEAD.encode() in content and IMAGES_HEAD.encode() in content


@reader("COLMAP text", is_content=is_text)
def read(content: bytes, file: str) -> CameraFile:
    """Read the cameras of a file with both parts; ``InputError`` lists all its problems."""
    text = content.decode("utf-8", "replace")
    cut = text.index(IMAGES_HEAD)
    return read_parts(text[: text.rfind("\n", 0, cut) + 1], text[cut + len(IMAGES_HEAD) :].partition("\n")[2], file)


def read_parts(cameras_text: str, images_text: str, file: str) -> CameraFile:
    """Read the cameras of the texts of ``cameras.txt`` and ``images.txt``; ``InputError`` lists all their problems."""
    reading = Reading(file)
    lenses = {words[0]: words for words in map(str.split, _rows(cameras_text)) if words}
    raw = []
    for words in islice(_images(images_text), MAX_CAMERAS + 1):
        name = _name(" ".join(words[_NUM_IMAGE_WORDS - 1 :]))
        try:
            raw.append(_raw(name, words, lenses, reading))
        except (UnreadableError, ValueError) as error:
            message = "The line of the image or of its camera is malformed."
            reading.complain(CALIBRATION_UNREADABLE, message, name)
            raise InputError(reading.problems) from error
    return reading.contents("COLMAP text", raw, None, axes="arbitrary; Z must point up")


def _rows(text: str) -> Iterator[str]:
    return (line for line in text.splitlines() if not line.lstrip().startswith("#"))


def _images(text: str) -> Iterator[list[str]]:
    """Words of the first line of each image; the second line, its 2D points, may be empty."""
    is_second = False
    for line in _rows(text):
        words = line.split()
        if is_second and (not words or _is_points(words)):
            is_second = False
        elif words:
            yield words
            is_second = True


def _is_points(words: list[str]) -> bool:
    return len(words) % 3 == 0 and all(word.lstrip("-").isdigit() for word in words[2::3])


def _name(image: str) -> str:
    """Name of the camera: the folder of the image, else the image's name without its ending."""
    path = PurePosixPath(image.replace("\\", "/"))
    return path.parts[0] if len(path.parts) > 1 else path.stem


def _raw(name: str, image: list[str], lenses: Mapping[str, list[str]], reading: Reading) -> RawCamera:
    lens = lenses.get(image[8], []) if len(image) >= _NUM_IMAGE_WORDS else []
    if len(lens) < _NUM_CAMERA_WORDS:
        raise UnreadableError
    model = lens[1]
    if model not in _MODELS:
        message = f"The lens model {model[:40]} is not supported."
        hint = f"Undistort the videos, or use one of {', '.join(_MODELS)}."
        reading.complain(UNSUPPORTED_LENS, message, name, hint=hint)
    places, num_coefficients = _MODELS.get(model, _MODELS["PINHOLE"])
    parameters = [float(word) for word in lens[_NUM_CAMERA_WORDS:]]
    if model in _MODELS and len(parameters) != max(places) + 1 + num_coefficients:
        raise UnreadableError
    fx, fy, cx, cy = (parameters[place] if place < len(parameters) else 0.0 for place in places)
    coefficients: list[Any] = parameters[max(places) + 1 :] if model in _MODELS else []
    if coefficients:
        coefficients += [0.0] * (_MIN_COEFFICIENTS - len(coefficients))
    qw, qx, qy, qz, *translation = (float(word) for word in image[1:8])
    return RawCamera(
        name=name,
        size_px=[float(lens[2]), float(lens[3])],
        matrix=[[fx, 0.0, cx - 0.5], [0.0, fy, cy - 0.5], [0.0, 0.0, 1.0]],
        distortion=coefficients,
        rotation=quaternion_matrix(np.array([qx, qy, qz, qw])),
        translation_m=translation,
        lens="fisheye" if model.endswith("FISHEYE") else "standard",
    )
