"""Parse untrusted text and numbers: the result is a value or ``UnreadableError``, for any content."""

import json
import re
from collections.abc import Callable
from types import NoneType
from typing import Any, TypeVar

import numpy as np

# Python refuses to read integers of more than 4300 digits; floats end at 309.
_MAX_DIGITS = 300
_LONG_INTEGER = re.compile(r"[0-9]{301}")

_Content = TypeVar("_Content")
_Parsed = TypeVar("_Parsed")


class UnreadableError(ValueError):
    """The content is not in the expected format."""


def parse(parser: Callable[[_Content], _Parsed], content: _Content) -> _Parsed:
    """Call a library's parser; any exception caused by the content becomes ``UnreadableError``.

    Libraries raise undocumented exceptions: an XML file with an unknown encoding is a ``LookupError``, a
    long integer in TOML a bare ``ValueError``, deep nesting a ``RecursionError``.
    """
    try:
        return parser(content)
    except MemoryError:
        raise
    except Exception as error:
        raise UnreadableError(type(error).__name__) from error


def read_json(content: bytes) -> Any:
    """Parse JSON; an integer of more than 300 digits becomes infinity, like ``1e400``."""
    return parse(_loads, content)


def read_unique_json(content: bytes) -> Any:
    """Parse JSON as ``read_json`` does; an object with a repeated key is unreadable."""
    return parse(lambda known: _loads(known, _unique), content)


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    fields = dict(pairs)
    if len(fields) < len(pairs):
        raise UnreadableError
    return fields


def _loads(content: bytes, hook: Callable[[list[tuple[str, Any]]], Any] | None = None) -> Any:
    text = content.decode(json.detect_encoding(content), "surrogatepass")
    # Calling a Python function for each integer would take most of the time of a large file.
    return json.loads(text, parse_int=_integer if _LONG_INTEGER.search(text) else None, object_pairs_hook=hook)


def _integer(digits: str) -> int | float:
    return int(digits) if len(digits) <= _MAX_DIGITS else float(digits)


def read_numbers(value: Any) -> np.ndarray:
    """Convert nested lists of numbers to an array of floats; raises ``UnreadableError`` for other values.

    Text and booleans are refused, although NumPy would convert them. ``None`` becomes NaN.
    """
    array = parse(_floats, value)
    kinds = set(map(type, np.array(value, dtype=object).ravel().tolist()))
    if bool in kinds or not all(issubclass(kind, (int, float, NoneType)) for kind in kinds):
        raise UnreadableError
    return array


def _floats(value: Any) -> np.ndarray:
    return np.array(value, dtype=np.float64)
