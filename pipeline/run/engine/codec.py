"""Records in NumPy archives: outputs of stages, byte-identical for equal records.

A record is a dataclass or a named tuple of arrays, numbers, texts, tuples, mappings and further records. Each array is
an entry of the archive under its path in the record, such as ``people.tracks.3.xyz_m``; all else is a JSON document.
Fields that have their default are left out: they cost no byte, and a record may get new ones. There are no pickles: a
file that was tampered with can't run code. The types of a record's fields say how it is read.
"""

import functools
import json
import operator
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np

from pipeline.core.runtime.npz import encode_arrays, open_archive, read_array, save_arrays
from pipeline.run.engine.stage import Context

# A record's class, or a tuple of such: `tuple[X, ...]` is no instance of `type`.
_Kind = TypeVar("_Kind")
# Entry of the JSON document.
_DOCUMENT = "record"


def encode(record: object) -> bytes:
    """Write a record, or a tuple of records, into memory."""
    return encode_arrays(_arrays(record))


def save(record: object, path: Path) -> None:
    """Write a record into a file: beside a large one, the archive would take as much memory again."""
    with path.open("wb") as file:
        save_arrays(file, _arrays(record))


def decode(kind: Callable[..., _Kind], content: bytes | Path) -> _Kind:
    """Read a record of a type that ``encode`` or ``save`` wrote."""
    return RecordArchive(content).read(kind)


def output_records(
    context: Context, stage: str, kind: Callable[..., _Kind], tasks: slice = slice(None)
) -> Iterator[_Kind]:
    """Outputs of tasks of an earlier stage as the records that were encoded, in the tasks' order."""
    return (decode(kind, content) for content in context.outputs(stage, tasks))


def output_record(context: Context, stage: str, kind: Callable[..., _Kind]) -> _Kind:
    """Output of the single task of an earlier stage as the record that was encoded."""
    (record,) = output_records(context, stage, kind)
    return record


class RecordArchive:
    """A record in an archive, of which parts are read when they are asked for.

    ``content`` is what ``encode`` returned, or the file that ``save`` wrote. It is open as long as the archive is used:
    the list of entries of thousands of people takes a tenth of a second to read.
    """

    def __init__(self, content: bytes | Path) -> None:
        self._entries = open_archive(content)
        self._document = json.loads(self._entries[_DOCUMENT].tobytes())
        self._arrays = frozenset(self._entries.files)

    def read(self, kind: Callable[..., _Kind], *path: str | int) -> _Kind:
        """Read the record at a path of fields and of numbers in tuples; without a path the whole record.

        The fields of a path have no defaults.
        """
        document = functools.reduce(operator.getitem, path, self._document)
        return cast(_Kind, self._value(kind, document, ".".join(map(str, path))))

    def find(self, kind: Callable[..., _Kind], *path: str | int) -> _Kind | None:
        """Read the record at a path as ``read`` does; ``None`` if the field is ``None``."""
        return self.read(kind, *path)

    def _value(self, kind: Any, document: Any, path: str) -> Any:
        """Value of a type from its JSON value and the archive's arrays."""
        if path in self._arrays:
            return read_array(self._entries, path)
        if document is None:
            return None
        if get_origin(kind) in {UnionType, Union}:
            (kind,) = (member for member in get_args(kind) if member is not NoneType)
        arguments = get_args(kind)
        if isinstance(document, list):
            kinds = arguments if len(arguments) > 1 and arguments[1] is not ... else arguments[:1] * len(document)
            return tuple(self._values(enumerate(kinds), document, path).values())
        if not isinstance(document, dict):
            return document
        if _defaults(kind) is None:
            inside = arguments[1] if arguments else Any
            return self._values(((name, inside) for name in document), document, path)
        hints = _hints(kind)
        return kind(**self._values(((name, hints[name]) for name in document), document, path))

    def _values(self, kinds: Iterable[tuple[Any, Any]], document: Any, path: str) -> dict[Any, Any]:
        """Values of a document's parts by their names or numbers, each with its type."""
        return {step: self._value(kind, document[step], _joined(path, step)) for step, kind in kinds}


def _arrays(record: object) -> dict[str, np.ndarray]:
    arrays: dict[str, np.ndarray] = {}
    document = _document(record, "", arrays)
    return {**arrays, _DOCUMENT: np.frombuffer(json.dumps(document).encode(), np.uint8)}


def _document(value: Any, path: str, arrays: dict[str, np.ndarray]) -> Any:
    """JSON value; arrays go to ``arrays`` under their paths, and leave ``None``."""
    if isinstance(value, np.ndarray):
        arrays[path] = value
        return None
    if isinstance(value, np.generic):
        return value.item()
    if (defaults := _record_defaults(value)) is not None:
        changed = (name for name, default in defaults.items() if not _equal(getattr(value, name), default))
        return {name: _document(getattr(value, name), _joined(path, name), arrays) for name in changed}
    if isinstance(value, Mapping):
        return {name: _document(part, _joined(path, name), arrays) for name, part in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_document(part, _joined(path, number), arrays) for number, part in enumerate(value)]
    return value


@functools.cache
def _defaults(kind: Any) -> Mapping[str, Any] | None:
    """Fields of a type of records with their defaults, ``MISSING`` where there is none; ``None`` of other types."""
    if isinstance(kind, type) and is_dataclass(kind):
        return {
            field.name: field.default_factory() if field.default_factory is not MISSING else field.default
            for field in fields(kind)
        }
    if hasattr(kind, "_field_defaults"):
        return {name: kind._field_defaults.get(name, MISSING) for name in kind._fields}
    return None


def _record_defaults(value: Any) -> Mapping[str, Any] | None:
    kind: Any = type(value)
    return _defaults(kind)


@functools.cache
def _hints(kind: type) -> Mapping[str, Any]:
    return get_type_hints(kind)


def _equal(value: Any, default: Any) -> bool:
    """True if two values are of one type and equal, down to the arrays of records."""
    if type(value) is not type(default):
        return False
    if isinstance(value, np.ndarray):
        return value.dtype == default.dtype and value.shape == default.shape and np.array_equal(value, default)
    if (names := _record_defaults(value)) is not None:
        return all(_equal(getattr(value, name), getattr(default, name)) for name in names)
    return bool(value == default)


def _joined(path: str, step: str | int) -> str:
    return f"{path}.{step}" if path else str(step)
