"""Values of untrusted pickles: numbers, texts, lists, dicts and NumPy arrays.

A pickle is a program that may call any function of any installed module. ``pickle`` follows it here without any of
them: the four functions that NumPy writes for arrays lead to the stand-ins below, and a call of another one is refused.
The unpickler written in Python is used, since the one in C allocates as much memory as a file names.
"""

import io
import pickle
import struct
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np

from pipeline.core.parsing import UnreadableError

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
