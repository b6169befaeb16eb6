"""OpenCap's ``cameraIntrinsicsExtrinsics.pickle`` (a file a camera) and MVPose's ``camera_parameter.pickle``.

OpenCap: ``x = K (R X + t)``, millimetres, the board's axes; ``imageSize`` is height, then width. The board stands
upright, perhaps upside down, or lies on the floor: the cameras, which stand upright, tell its axis that is vertical. A
file of a phone's model, ``cameraIntrinsics.pickle``, has no pose. MVPose (zju3dv): stacks ``K`` (cameras, 3, 3) and
``RT`` (cameras, 3, 4), world to camera, no distortion, no sizes of pictures; the unit is the data set's.

Rows of the table of formats:

| MVPose (zju3dv) | `.pickle` with the stacks `K` and `RT` (`camera_parameter.pickle`) | `units` | as calibrated;
cameras are called `0`, `1`, ..., videos may be called `Camera0` |
| OpenCap | `.zip` with a `.pickle` for each camera: `Cam0/cameraIntrinsicsExtrinsics.pickle`, or `Cam0.pickle` | mm |
axes of the board, turned to Z up; the upright cameras tell how the board stood or lay |
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from pipeline.calibration.contents import CameraFile
from pipeline.calibration.formats import reader
from pipeline.calibration.readers.fields import read_size, size_names
from pipeline.calibration.readers.pickle_values import read_values
from pipeline.calibration.reading import Reading
from pipeline.calibration.validate import MAX_CAMERAS, RawCamera
from pipeline.calibration.vertical import upright_by_cameras
from pipeline.core.errors import InputError, Problem
from pipeline.core.parsing import UnreadableError, read_numbers
from pipeline.core.problems.session_codes import CALIBRATION_UNREADABLE

_OPENCAP = frozenset({"intrinsicMat", "distortion", "imageSize"})
_MVPOSE = frozenset({"K", "RT"})
# Fields that repeat others.
_OPENCAP_PASSED_OVER = frozenset({"rotation", "translation", "rotation_EulerAngles"})
_MVPOSE_PASSED_OVER = frozenset({"P"})
_BOARD_NOTE = "the cameras don't tell the vertical; OpenCap's board is taken to have stood upright"


@reader("OpenCap and MVPose", suffixes=(".pickle", ".pkl"))
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
        reading = Reading(file)
        return reading.contents("MVPose pickle", _mvpose(next(iter(documents.values())), reading), None)
    if not all(document.keys() >= _OPENCAP for document in documents.values()):
        raise UnreadableError
    raw, reading = [_raw_opencap(name, document) for name, document in documents.items()], Reading(file)
    for document, raw_camera in zip(documents.values(), raw, strict=True):
        reading.pass_over(document, _OPENCAP | _OPENCAP_PASSED_OVER, raw_camera)
    return upright_by_cameras(reading.contents("OpenCap", raw, "mm"), "-y", f"{file}: {_BOARD_NOTE}.")


def _mvpose(document: Mapping[str, Any], reading: Reading) -> list[RawCamera]:
    matrices, poses = _stack(document["K"], (3, 3)), _stack(document["RT"], (3, 4))
    if len(matrices) != len(poses):
        raise UnreadableError
    raw = []
    for number, (matrix, pose) in enumerate(zip(matrices, poses, strict=True)):
        # Other fields are stacks too, or of all cameras, such as a pair of sides.
        fields = {
            key: value[number] if isinstance(value, list) and np.ndim(value) > 1 and len(value) == len(poses) else value
            for key, value in document.items()
            if key not in _MVPOSE | _MVPOSE_PASSED_OVER
        }
        name, size_px = str(number), read_size(str(number), fields, reading)
        raw.append(RawCamera(name, size_px, matrix, [], pose[:, :3], pose[:, 3], section=f"Camera{number}"))
        reading.pass_over(fields, size_names(fields), raw[-1])
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
        rotation=document.get("rotation"),
        translation_m=None if document.get("translation") is None else _flat(document["translation"]),
    )


def _flat(value: Any) -> list[float]:
    return read_numbers(value).ravel().tolist()
