"""Safe reader of pickles of numbers, texts, lists, dicts and NumPy arrays.

A pickle is a program that may call any function of any installed module. ``pickle`` itself is not used: a stack
machine follows the operations that ``pickletools`` lists. It knows only the operations that Python writes for plain
values in protocols 0 to 5, and only the four names of functions that NumPy writes for arrays. It imports nothing and
calls nothing that the file names.
"""

import pickletools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.core.parsing import UnreadableError

# OpenCap's files have about 130 operations and 2 kB; names of columns, as PyTables stores them, some 5 a column.
_MAX_OPERATIONS = 100_000
_MAX_BYTES = 1 * 2**20
_MAX_ITEMS = 100_000
_MAX_DEPTH = 10
_KINDS = frozenset("fiu")
_MARK = object()


@dataclass(frozen=True, slots=True)
class _Name:
    """Name of a function or a class in the file."""

    module: str
    name: str


@dataclass(slots=True)
class _Type:
    """Type of an array's numbers; ``order`` follows in an operation of its own."""

    code: str
    order: str = "<"

    def set_state(self, state: Any) -> None:
        if not isinstance(state, tuple) or len(state) < 2 or state[1] not in {"<", ">", "|", "="}:
            raise UnreadableError
        self.order = "<" if state[1] == "=" else state[1]

    def numpy(self) -> np.dtype:
        if self.code[:1] not in _KINDS or self.code[1:] not in {"1", "2", "4", "8"}:
            raise UnreadableError
        return np.dtype(("" if self.order == "|" else self.order) + self.code)


@dataclass(slots=True)
class _Array:
    """Array whose contents follow in an operation of their own."""

    numbers: np.ndarray | None = None

    def set_state(self, state: Any) -> None:
        if not isinstance(state, tuple) or len(state) != 5:
            raise UnreadableError
        _, shape, kind, is_fortran, data = state
        self.numbers = _filled(data, kind, shape, "F" if is_fortran is True else "C")


def read_values(content: bytes) -> Any:
    """Read the value of a pickle: dicts, lists, tuples, texts, numbers; arrays become nested lists.

    Raises ``UnreadableError`` for damaged pickles, for all other operations and names, and for more than a megabyte.
    """
    if len(content) > _MAX_BYTES:
        raise UnreadableError
    machine = _Machine()
    try:
        for number, (operation, argument, _) in enumerate(pickletools.genops(content)):
            if number > _MAX_OPERATIONS:
                raise UnreadableError
            machine.follow(operation.name, argument)
        return _plain(machine.result(), [_MAX_ITEMS])
    except (ValueError, TypeError, IndexError, KeyError, OverflowError, AttributeError, RecursionError) as error:
        raise UnreadableError(type(error).__name__) from error


class _Machine:
    """Stack and memory of a pickle."""

    def __init__(self) -> None:
        self._stack: list[Any] = []
        self._memory: dict[int, Any] = {}

    def follow(self, operation: str, argument: Any) -> None:
        """Follow an operation; raises ``UnreadableError`` for unknown ones."""
        if operation in _PLAIN:
            self._stack.append(argument)
        elif operation in _CONSTANTS:
            self._stack.append(_CONSTANTS[operation]())
        elif operation in _TUPLES:
            self._stack.append(tuple(self._pop_last(_TUPLES[operation])))
        elif operation in {"PROTO", "FRAME", "STOP"}:
            return
        elif operation in {"PUT", "BINPUT", "LONG_BINPUT", "MEMOIZE"}:
            self._memory[len(self._memory) if argument is None else argument] = self._stack[-1]
        elif operation in {"GET", "BINGET", "LONG_BINGET"}:
            self._stack.append(self._memory[argument])
        elif operation in _METHODS:
            _METHODS[operation](self, argument)
        else:
            raise UnreadableError(operation)

    def result(self) -> Any:
        """Return the value that is left when the file ends."""
        (value,) = self._stack
        return value

    def _pop(self) -> Any:
        value = self._stack.pop()
        if value is _MARK:
            raise UnreadableError
        return value

    def _pop_last(self, count: int) -> list[Any]:
        return [self._pop() for _ in range(count)][::-1]

    def _pop_marked(self) -> list[Any]:
        items: list[Any] = []
        while (value := self._stack.pop()) is not _MARK:
            items.append(value)
        return items[::-1]

    def _mark(self, _: Any) -> None:
        self._stack.append(_MARK)

    def _tuple(self, _: Any) -> None:
        self._stack.append(tuple(self._pop_marked()))

    def _list(self, _: Any) -> None:
        self._stack.append(self._pop_marked())

    def _dict(self, _: Any) -> None:
        items = self._pop_marked()
        self._stack.append({})
        self._update(items)

    def _global(self, argument: str) -> None:
        module, _, name = argument.partition(" ")
        self._stack.append(_Name(module, name))

    def _stack_global(self, _: Any) -> None:
        module, name = self._pop_last(2)
        self._stack.append(_Name(str(module), str(name)))

    def _append(self, _: Any) -> None:
        self._extend(self._pop_last(1))

    def _appends(self, _: Any) -> None:
        self._extend(self._pop_marked())

    def _extend(self, items: list[Any]) -> None:
        if type(self._stack[-1]) is not list:
            raise UnreadableError
        self._stack[-1].extend(items)

    def _set_item(self, _: Any) -> None:
        self._update(self._pop_last(2))

    def _set_items(self, _: Any) -> None:
        self._update(self._pop_marked())

    def _update(self, items: list[Any]) -> None:
        if type(self._stack[-1]) is not dict or len(items) % 2 or not all(isinstance(key, str) for key in items[::2]):
            raise UnreadableError
        self._stack[-1].update(zip(items[::2], items[1::2], strict=True))

    def _reduce(self, _: Any) -> None:
        name, arguments = self._pop_last(2)
        if not isinstance(name, _Name) or not isinstance(arguments, tuple):
            raise UnreadableError
        self._stack.append(_FUNCTIONS[name](*arguments))

    def _build(self, _: Any) -> None:
        state = self._pop()
        if not isinstance(self._stack[-1], (_Type, _Array)):
            raise UnreadableError
        self._stack[-1].set_state(state)


def _filled(data: Any, kind: Any, shape: Any, order: Any) -> np.ndarray:
    """Build an array of the numbers in ``data``."""
    if not isinstance(data, (bytes, bytearray)) or not isinstance(kind, _Type) or not isinstance(shape, tuple):
        raise UnreadableError
    flat = np.frombuffer(data, kind.numpy())
    return flat.reshape(shape, order="F" if order == "F" else "C").astype(np.float64)


def _type(code: Any, *_: Any) -> _Type:
    if not isinstance(code, str):
        raise UnreadableError
    return _Type(code)


def _empty_array(*_: Any) -> _Array:
    return _Array()


def _array(data: Any, kind: Any, shape: Any, order: Any) -> _Array:
    return _Array(_filled(data, kind, shape, order))


def _scalar(kind: Any, data: Any) -> float:
    return float(_filled(data, kind, (), "C"))


def _plain(value: Any, num_left: list[int], depth: int = 0) -> Any:
    """Replace arrays by nested lists.

    A value may contain another one many times, so that it is larger than its file: ``num_left`` holds the number of
    items that are still allowed.
    """
    num_left[0] -= value.numbers.size if isinstance(value, _Array) and value.numbers is not None else 1
    if depth > _MAX_DEPTH or num_left[0] < 0:
        raise UnreadableError
    if isinstance(value, dict):
        return {key: _plain(entry, num_left, depth + 1) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(entry, num_left, depth + 1) for entry in value]
    if isinstance(value, _Array) and value.numbers is not None:
        return value.numbers.tolist()
    if value is None or isinstance(value, (str, int, float, bytes)):
        return value
    raise UnreadableError


_PLAIN = frozenset(
    {
        "INT", "LONG", "FLOAT", "UNICODE",
        "BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT", "SHORT_BINUNICODE", "BINUNICODE", "BINUNICODE8",
        "SHORT_BINBYTES", "BINBYTES", "BINBYTES8", "BYTEARRAY8",
    }
)  # fmt: skip
_CONSTANTS: Mapping[str, Callable[[], Any]] = {
    "NONE": lambda: None,
    "NEWTRUE": lambda: True,
    "NEWFALSE": lambda: False,
    "EMPTY_TUPLE": tuple,
    "EMPTY_LIST": list,
    "EMPTY_DICT": dict,
}
_TUPLES: Mapping[str, int] = {"TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}
_METHODS: Mapping[str, Callable[[_Machine, Any], None]] = {
    "MARK": _Machine._mark,
    "TUPLE": _Machine._tuple,
    "LIST": _Machine._list,
    "DICT": _Machine._dict,
    "GLOBAL": _Machine._global,
    "STACK_GLOBAL": _Machine._stack_global,
    "APPEND": _Machine._append,
    "APPENDS": _Machine._appends,
    "SETITEM": _Machine._set_item,
    "SETITEMS": _Machine._set_items,
    "REDUCE": _Machine._reduce,
    "BUILD": _Machine._build,
}
_FUNCTIONS: Mapping[_Name, Callable[..., Any]] = {
    _Name("numpy", "dtype"): _type,
    # NumPy 1 and 2 name the module differently.
    **{_Name(f"numpy.{core}.multiarray", "_reconstruct"): _empty_array for core in ("core", "_core")},
    **{_Name(f"numpy.{core}.multiarray", "scalar"): _scalar for core in ("core", "_core")},
    **{_Name(f"numpy.{core}.numeric", "_frombuffer"): _array for core in ("core", "_core")},
}
