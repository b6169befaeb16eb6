"""Records as JSON values, read by the types of their fields. Standard library only.

A record is a dataclass or a named tuple of numbers, texts, paths, enumerations, ranges, tuples, mappings and further
records. Fields that have their default are left out: they cost no byte, and a record may get new ones.
"""

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from enum import Enum
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

# A record's class, or a tuple of such: `tuple[X, ...]` is no instance of `type`.
Kind = TypeVar("Kind")
Missing = Callable[[str], Any]


def to_json(value: Any, prepare: Callable[[Any, str], Any] = lambda value, path: value, path: str = "") -> Any:
    """JSON value of a record, or of a tuple of records.

    ``prepare`` gets each value with its path, such as ``people.tracks.3``, and returns what is written in its place.
    """
    value = prepare(value, path)
    if (defaults := _record_defaults(value)) is not None:
        changed = (name for name, default in defaults.items() if not _equal(getattr(value, name), default))
        return {name: to_json(getattr(value, name), prepare, joined(path, name)) for name in changed}
    if isinstance(value, Mapping):
        return {name: to_json(part, prepare, joined(path, name)) for name, part in value.items()}
    if isinstance(value, range):
        return [value.start, value.stop]
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [to_json(part, prepare, joined(path, number)) for number, part in enumerate(value)]
    return value


def from_json(kind: Callable[..., Kind], document: Any, missing: Missing | None = None, path: str = "") -> Kind:
    """Value of a type from its JSON value; ``missing`` gives the value at a path whose JSON value is null.

    A tuple is taken for a list. Raises ``KeyError``, ``TypeError`` or ``ValueError`` if the JSON value is no record of
    the type.
    """
    return cast(Kind, _reader(kind)(document, missing, path))


@functools.cache
def _reader(kind: Any) -> Callable[[Any, Missing | None, str], Any]:
    """Function that reads values of a type: it is made once, because a page of jobs has thousands of values."""
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in {UnionType, Union}:
        members = [member for member in arguments if member is not NoneType]
        of_dict, of_other = (
            _reader(next((member for member in members if (_defaults(member) is not None) == is_record), members[0]))
            for is_record in (True, False)
        )
        return lambda document, *rest: (of_dict if isinstance(document, dict) else of_other)(document, *rest)
    is_record, is_tuple = _defaults(kind) is not None, origin is tuple
    is_fixed = is_tuple and len(arguments) > 1 and arguments[1] is not ...
    inside = arguments[1] if len(arguments) > 1 and not is_tuple else (*arguments, Any)[0]
    of_list = list if kind is Any or origin is list else frozenset if origin is frozenset else tuple
    is_made = isinstance(kind, type) and issubclass(kind, Path | Enum)

    def read(document: Any, missing: Missing | None, path: str) -> Any:
        if document is None:
            return None if missing is None else missing(path)
        is_list, is_dict = isinstance(document, list | tuple), isinstance(document, dict)
        if is_record > is_dict or is_tuple > is_list:
            raise TypeError(f"{path} is no {kind}")
        if is_dict:
            kinds = _hints(kind) if is_record else dict.fromkeys(document, inside)
            values = {
                name: part
                if type(part) is kinds[name]
                else _reader(kinds[name])(part, missing, path if missing is None else joined(path, name))
                for name, part in document.items()
            }
            return kind(**values) if is_record else values
        if is_list and kind is not range:
            kinds_in_order = arguments if is_fixed else (inside,) * len(document)
            return of_list(
                _reader(part_kind)(part, missing, path if missing is None else joined(path, number))
                for number, (part_kind, part) in enumerate(zip(kinds_in_order, document, strict=True))
            )
        return range(*document) if is_list else kind(document) if is_made else document

    return read


def joined(path: str, step: str | int) -> str:
    """Path of a part of the value at a path."""
    return f"{path}.{step}" if path else str(step)


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
    if hasattr(value, "dtype"):
        same = value.dtype == default.dtype and value.shape == default.shape
        return bool(same and (value == default).all())
    if (names := _record_defaults(value)) is not None:
        return all(_equal(getattr(value, name), getattr(default, name)) for name in names)
    return bool(value == default)
