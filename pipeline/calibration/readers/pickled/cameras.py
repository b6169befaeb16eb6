"""OpenCap's ``cameraIntrinsicsExtrinsics.pickle`` (a file a camera) and MVPose's ``camera_parameter.pickle``.

OpenCap: ``x = K (R X + t)``, millimetres, the board's axes; ``imageSize`` is height, then width. An upright board has
y down. MVPose (zju3dv): stacks ``K`` (cameras, 3, 3) and ``RT`` (cameras, 3, 4), world to camera, no distortion, no
sizes of pictures; the unit is that of the data set.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from pipeline.calibration.contents import UNKNOWN_SIZE, CameraFile
from pipeline.calibration.readers.pickled.interpreter import read_values
from pipeline.calibration.reading import Reading
from pipeline.calibration.validate import MAX_CAMERAS, RawCamera
from pipeline.errors import InputError, Problem
from pipeline.parsing import UnreadableError, read_numbers
from pipeline.problem_codes.sessions import CALIBRATION_UNREADABLE

_OPENCAP = frozenset({"intrinsicMat", "distortion", "rotation", "translation", "imageSize"})
_MVPOSE = frozenset({"K", "RT"})
# From a world with z up to that of an upright board, whose y points down.
_BOARD_FROM_UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
# Far outside of every plausible entry of a rotation, so that products stay finite.
_MAX_ENTRY = 10.0
_BOARD_NOTE = "OpenCap's board is taken to have stood upright; for a board on the floor, turn the calibration first."


def read(content: bytes, file: str) -> CameraFile:
    """Read the cameras of one pickle; ``InputError`` lists all its problems."""
    try:
        return read_members({file.partition(".")[0]: content}, file)
    except UnreadableError as error:
        message = "The file is damaged, or has other contents than the arrays of a calibration."
        raise InputError([Problem(CALIBRATION_UNREADABLE, message, file=file, hint="Export it again.")]) from error


def read_members(members: Mapping[str, bytes], file: str) -> CameraFile:
    """Read pickles by the names of their cameras.

    Raises ``InputError`` with all problems of all cameras; ``UnreadableError`` if a pickle has anything but plain
    values and arrays, or not the keys of these formats.
    """
    documents = {name: read_values(members[name]) for name in list(members)[: MAX_CAMERAS + 1]}
    if not all(isinstance(document, dict) for document in documents.values()):
        raise UnreadableError
    if len(documents) == 1 and next(iter(documents.values())).keys() >= _MVPOSE:
        return Reading(file).contents("MVPose pickle", _mvpose(next(iter(documents.values()))), None)
    if not all(document.keys() >= _OPENCAP for document in documents.values()):
        raise UnreadableError
    reading = Reading(file)
    reading.notes.append(_BOARD_NOTE)
    raw = [_raw_opencap(name, document) for name, document in documents.items()]
    return reading.contents("OpenCap", raw, "mm", axes="y down, turned to Z up")


def _mvpose(document: Mapping[str, Any]) -> list[RawCamera]:
    matrices, poses = _stack(document["K"], (3, 3)), _stack(document["RT"], (3, 4))
    if len(matrices) != len(poses):
        raise UnreadableError
    raw = [
        RawCamera(str(number), UNKNOWN_SIZE, matrix, [], pose[:, :3], pose[:, 3], section=f"Camera{number}")
        for number, (matrix, pose) in enumerate(zip(matrices, poses, strict=True))
    ]
    return raw[: MAX_CAMERAS + 1]


def _stack(value: Any, shape: tuple[int, int]) -> np.ndarray:
    array = read_numbers(value)
    if array.ndim != 3 or array.shape[1:] != shape:
        raise UnreadableError
    return array


def _raw_opencap(name: str, document: Mapping[str, Any]) -> RawCamera:
    height_and_width = _flat(document["imageSize"])
    return RawCamera(
        name=name,
        size_px=height_and_width[::-1],
        matrix=document["intrinsicMat"],
        distortion=_flat(document["distortion"]),
        rotation=_upright(document["rotation"]),
        translation_m=_flat(document["translation"]),
    )


def _flat(value: Any) -> list[float]:
    return read_numbers(value).ravel().tolist()


def _upright(rotation: Any) -> Any:
    """Rotation from the upright world; a matrix of implausible numbers is left to the checks."""
    matrix = read_numbers(rotation)
    is_plausible = matrix.shape == (3, 3) and (np.abs(matrix) < _MAX_ENTRY).all()
    return matrix @ _BOARD_FROM_UPRIGHT if is_plausible else rotation
