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

import io
import pickle
import struct
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np

from pipeline.calibration.contents import CameraFile
from pipeline.calibration.formats import reader
from pipeline.calibration.readers.fields import read_size, size_names
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


# Values of untrusted pickles: numbers, texts, lists, dicts and NumPy arrays. A pickle is a program that may call any
# function of any installed module. `pickle` follows it here without any of them: the four functions that NumPy writes
# for arrays lead to the stand-ins below, and a call of another one is refused. The unpickler written in Python is used,
# since the one in C allocates as much memory as a file names.

# OpenCap's files have about 100 items and 2 kB.
_MAX_BYTES = 1 * 2**20
_MAX_ITEMS = 100_000
_MAX_DEPTH = 10
_KINDS = frozenset("fiu")


def read_values(content: bytes) -> Any:
    """Read the value of a pickle: dicts, lists, tuples, texts, numbers; arrays become nested lists.

    Raises ``UnreadableError`` for damaged pickles, for all other types and names, and for more than a megabyte.
    """
    if len(content) > _MAX_BYTES:
        raise UnreadableError
    try:
        return _plain(_Unpickler(io.BytesIO(content)).load(), [_MAX_ITEMS])
    except UnreadableError:
        raise
    except Exception as error:  # pickle raises all kinds of exceptions for a damaged file
        raise UnreadableError(type(error).__name__) from error


class _Unpickler(pickle._Unpickler):
    append: Callable[[Any], None]
    read: Callable[[int], bytes]
    stack: list[Any]
    metastack: list[Any]
    dispatch: ClassVar[dict[int, Callable[..., None]]] = dict(pickle._Unpickler.dispatch)

    def load(self) -> Any:
        """Read the one value of the file."""
        value = super().load()
        if self.stack or self.metastack:
            raise UnreadableError
        return value

    def load_bytearray8(self) -> None:
        """Read a long array of bytes; Python's own function first allocates as much memory as the file names."""
        (length,) = struct.unpack("<Q", self.read(8))
        self.append(bytearray(self.read(length)))

    dispatch[pickle.BYTEARRAY8[0]] = load_bytearray8

    def find_class(self, module: str, name: str) -> "_Function":
        """Stand-in for a function or a class. A file may change it, so that each is made for one use."""
        return _Function(_FUNCTIONS.get((module, name), _refused))


class _Function:
    """Function that a file may call."""

    __slots__ = ("_call",)

    def __init__(self, call: Callable[..., Any]) -> None:
        self._call = call

    def __call__(self, *arguments: Any) -> Any:
        return self._call(*arguments)


class _Type:
    """Type of an array's numbers; the order of their bytes follows in an operation of its own."""

    __slots__ = ("code", "order")

    def __init__(self, code: str, *_: Any) -> None:
        self.code, self.order = code, "<"

    def __setstate__(self, state: Any) -> None:
        self.order = {"=": "<"}.get(state[1], state[1])

    def numpy(self) -> np.dtype:
        is_number = self.code[:1] in _KINDS and self.code[1:] in {"1", "2", "4", "8"}
        if not is_number or self.order not in {"<", ">", "|"}:
            raise UnreadableError
        return np.dtype(self.order.replace("|", "") + self.code)


class _Array:
    """Array whose contents may follow in an operation of their own."""

    __slots__ = ("numbers",)

    def __init__(self, *_: Any) -> None:
        self.numbers: np.ndarray | None = None

    def __setstate__(self, state: Any) -> None:
        _, shape, kind, is_fortran, data = state
        self.numbers = _filled(data, kind, shape, "F" if is_fortran is True else "C")


def _filled(data: Any, kind: Any, shape: Any, order: Any) -> np.ndarray:
    """Build an array of the numbers in ``data``."""
    if not isinstance(data, (bytes, bytearray)) or not isinstance(kind, _Type) or not isinstance(shape, tuple):
        raise UnreadableError
    flat = np.frombuffer(data, kind.numpy())
    return flat.reshape(shape, order="F" if order == "F" else "C").astype(np.float64)


def _refused(*_: Any) -> None:
    raise UnreadableError


def _whole_array(*state: Any) -> _Array:
    array = _Array()
    array.numbers = _filled(*state)
    return array


def _plain(value: Any, num_left: list[int], depth: int = 0) -> Any:
    """Replace arrays by nested lists.

    A value may contain another one many times, so that it is larger than its file: ``num_left`` holds the number of
    items that are still allowed.
    """
    num_left[0] -= value.numbers.size if isinstance(value, _Array) and value.numbers is not None else 1
    if depth > _MAX_DEPTH or num_left[0] < 0:
        raise UnreadableError
    if isinstance(value, dict) and all(isinstance(key, str) for key in value):
        return {key: _plain(entry, num_left, depth + 1) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(entry, num_left, depth + 1) for entry in value]
    if isinstance(value, _Array) and value.numbers is not None:
        return value.numbers.tolist()
    if value is None or isinstance(value, (str, int, float, bytes)):
        return value
    raise UnreadableError


_FUNCTIONS: Mapping[tuple[str, str], Callable[..., Any]] = {
    ("numpy", "dtype"): _Type,
    # NumPy 1 and 2 name the module differently.
    **{(f"numpy.{core}.multiarray", "_reconstruct"): _Array for core in ("core", "_core")},
    **{
        (f"numpy.{core}.multiarray", "scalar"): lambda kind, data: float(_filled(data, kind, (), "C"))
        for core in ("core", "_core")
    },
    **{(f"numpy.{core}.numeric", "_frombuffer"): _whole_array for core in ("core", "_core")},
}
