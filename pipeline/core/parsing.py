"""Untrusted text, tables and numbers of files: parsing, and the allowed ranges of quantities.

Parsing gives a value or ``UnreadableError``, for any content. The ranges are far wider than real values: within them
no product or square in the geometry overflows. The readers refuse numbers outside.
"""

import codecs
import csv
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import NoneType
from typing import Any, NamedTuple, TextIO, TypeVar

import numpy as np
from pydantic_core import from_json

# Python refuses to read integers of more than 4300 digits; floats end at 309.
_MAX_DIGITS = 300
_LONG_INTEGER, _AS_ZEROS = b"0" * (_MAX_DIGITS + 1), bytes.maketrans(b"123456789", b"0" * 9)
_XML_ENCODING = re.compile(r"""(\A\s*<\?xml[^>]*?)\s+encoding\s*=\s*["'][^"'>]*["']""")

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


def in_utf_8(content: bytes) -> bytes:
    """Text of a file in UTF-8, if it is UTF-16 with its mark; other content as it is.

    XML then no longer states its encoding, which would be wrong.
    """
    if not content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return content
    try:
        text = content.decode("utf-16")
    except UnicodeDecodeError:
        return content
    return _XML_ENCODING.sub(r"\1", text, count=1).encode()


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
    if hook is None and _LONG_INTEGER not in content.translate(_AS_ZEROS):
        # Seven times as fast, with equal values. It refuses some texts that Python reads, such as UTF-16.
        with suppress(ValueError):
            return from_json(content)
    text = content.decode(json.detect_encoding(content), "surrogatepass")
    return json.loads(text, parse_int=_integer, object_pairs_hook=hook)


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


@dataclass(frozen=True, slots=True)
class Quantity:
    """Range of values with a unit; the limits are allowed.

    >>> str(Quantity(1, 20_000, "pixels"))
    '1 to 20,000 pixels'
    """

    low: int | float
    high: int | float
    unit: str

    def holds(self, values: float | np.ndarray, tolerance: float = 0.0) -> bool:
        """Return whether all values are in the range; NaN is not.

        ``tolerance``: share of a limit by which values may exceed it, for computed values, which are rounded.

        >>> rate_hz = 1000.0000000000002
        >>> FRAME_RATE_HZ.holds(rate_hz), FRAME_RATE_HZ.holds(rate_hz, tolerance=1e-3)
        (False, True)
        """
        array = np.asarray(values, dtype=np.float64)
        low, high = self.low - abs(self.low) * tolerance, self.high + abs(self.high) * tolerance
        return bool(((array >= low) & (array <= high)).all())

    def __str__(self) -> str:
        """Range and unit as messages show them."""
        return f"{self.low:,.10g} to {self.high:,.10g} {self.unit}".strip()


SIDE_PX = Quantity(1, 20_000, "pixels")
FOCAL_LENGTH_PX = Quantity(1, 1e6, "pixels")
PRINCIPAL_POINT_PX = Quantity(-1e5, 1e5, "pixels")
SKEW_PX = Quantity(-1e5, 1e5, "pixels")
# Coefficients grow as the angle of view shrinks: a telephoto lens, with r = 0.05 at the edge, may have a k3 of 600,000.
DISTORTION = Quantity(-1e9, 1e9, "")
ROTATION_VECTOR_RAD = Quantity(-100, 100, "radians")
# In the unit of the file: 10 km for millimetres.
TRANSLATION = Quantity(-1e7, 1e7, "")
KEYPOINT_PX = Quantity(-1e6, 1e6, "pixels")
FRAME_RATE_HZ = Quantity(1, 1000, "Hz")
# Tolerance of rates that are computed from times, which files round.
FRAME_RATE_TOLERANCE = 1e-3
# Time of a keypoint frame in a file of timestamps. A larger number is a date, not a time since the start.
TIME_S = Quantity(0, 1e6, "s")
# Time of a video's first frame, on the clock that all cameras share.
OFFSET_S = Quantity(-86_400, 86_400, "s")
# Duration of a session, from its first frame to its last.
DURATION_S = Quantity(0, 43_200, "s")


# Spreadsheets of languages with a decimal comma separate cells by semicolons; text for them has tabs.
_SEPARATORS = (";", "\t")
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+(?:[eE][+-]?\d+)?")


class Table(NamedTuple):
    """Table with a line of headers."""

    columns: tuple[str, ...]  # Names of the columns, in lower case
    rows: Iterator[tuple[int, Mapping[str, str]]]  # Number of the line, and cells by column; "" where they are missing

    def fault(self, needed: Sequence[str]) -> str | None:
        """Sentence on needed columns that the table lacks or has twice; ``None`` if it has each of them once."""
        if missing := [name for name in needed if name not in self.columns]:
            return f"The table lacks {', '.join(missing)}: its first line must name the columns {', '.join(needed)}."
        if repeated := [name for name in needed if self.columns.count(name) > 1]:
            return f"The table has more than one column {', '.join(repeated)}."
        return None


@contextmanager
def open_table(path: Path) -> Iterator[Table]:
    """Open a table, whose rows are read in the block.

    Cells are separated by commas, semicolons or tabs. With the latter two, numbers may have a decimal comma, which
    becomes a point. The text is UTF-8, or UTF-16 with its mark. Spaces around cells, the case of headers and empty
    lines are ignored. Opening and reading raise ``OSError``, ``ValueError`` for other text, and ``csv.Error`` for what
    is no CSV.
    """
    with path.open("rb") as file:
        is_utf_16 = file.read(2) in {codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE}
    with path.open(encoding="utf-16" if is_utf_16 else "utf-8-sig", newline="") as text:
        header = text.readline()
        separator = next((separator for separator in _SEPARATORS if separator in header), ",")
        cells = next(csv.reader([header], delimiter=separator, skipinitialspace=True), [])
        names = [cell.strip().lower() for cell in cells]
        yield Table(tuple(names), _rows(text, names, separator))


def _rows(text: TextIO, names: Sequence[str], separator: str) -> Iterator[tuple[int, Mapping[str, str]]]:
    reader = csv.reader(text, delimiter=separator, skipinitialspace=True)
    for cells in reader:
        if any(cells):
            values = [cell.strip() for cell in cells] + [""] * (len(names) - len(cells))
            if separator != ",":
                values = [value.replace(",", ".") if _DECIMAL_COMMA.fullmatch(value) else value for value in values]
            yield reader.line_num + 1, dict(zip(names, values, strict=False))
