"""Tables that people write: CSV as editors and spreadsheets of any language store it."""

import codecs
import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple, TextIO

# Spreadsheets of languages with a decimal comma separate cells by semicolons; text for them has tabs.
_SEPARATORS = (";", "\t")
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+(?:[eE][+-]?\d+)?")


class Table(NamedTuple):
    """Table with a line of headers."""

    columns: frozenset[str]  # Names of the columns, in lower case
    rows: Iterator[tuple[int, Mapping[str, str]]]  # Number of the line, and cells by column; "" where they are missing

    def missing(self, needed: Sequence[str]) -> list[str]:
        """Names of needed columns that the table lacks."""
        return [name for name in needed if name not in self.columns]


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
        yield Table(frozenset(names), _rows(text, names, separator))


def _rows(text: TextIO, names: Sequence[str], separator: str) -> Iterator[tuple[int, Mapping[str, str]]]:
    reader = csv.reader(text, delimiter=separator, skipinitialspace=True)
    for cells in reader:
        if any(cells):
            values = [cell.strip() for cell in cells] + [""] * (len(names) - len(cells))
            if separator != ",":
                values = [value.replace(",", ".") if _DECIMAL_COMMA.fullmatch(value) else value for value in values]
            yield reader.line_num + 1, dict(zip(names, values, strict=False))
