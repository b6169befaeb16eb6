"""Records in NumPy archives: outputs of stages, and opened sessions; byte-identical for equal records.

A record is one of ``pipeline.core.records`` with arrays. Each array is an entry of the archive under its path in the
record, such as ``people.tracks.3.xyz_m``; all else is a JSON document. There are no pickles: a file that was tampered
with can't run code.
"""

import functools
import io
import json
import operator
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from pipeline.core.records import Kind, from_json, to_json
from pipeline.core.runtime.npz import encode_arrays, open_archive, read_array, save_arrays

# Entry of the JSON document.
_DOCUMENT = "record"


def encode(record: object) -> bytes:
    """Write a record, or a tuple of records, into memory."""
    return encode_arrays(_arrays(record))


def save(record: object, path: Path) -> None:
    """Write a record into a file: beside a large one, the archive would take as much memory again."""
    with path.open("wb") as file:
        write(record, file)


def write(record: object, file: io.BufferedIOBase) -> None:
    """Write a record into an open file, as ``save`` does."""
    save_arrays(file, _arrays(record))


def decode(kind: Callable[..., Kind], content: bytes | Path | BinaryIO) -> Kind:
    """Read a record of a type that ``encode`` or ``save`` wrote."""
    return RecordArchive(content).read(kind)


class RecordArchive:
    """A record in an archive, of which parts are read when they are asked for.

    ``content`` is what ``encode`` returned, or the file that ``save`` wrote. It is open as long as the archive is used:
    the list of entries of thousands of people takes a tenth of a second to read.
    """

    def __init__(self, content: bytes | Path | BinaryIO) -> None:
        self._entries = open_archive(content)
        self._document = json.loads(self._entries[_DOCUMENT].tobytes())
        self._arrays = frozenset(self._entries.files)

    def read(self, kind: Callable[..., Kind], *path: str | int) -> Kind:
        """Read the record at a path of fields and of numbers in tuples; without a path the whole record.

        The fields of a path have no defaults.
        """
        document = functools.reduce(operator.getitem, path, self._document)
        return from_json(kind, document, self._array, ".".join(map(str, path)))

    def find(self, kind: Callable[..., Kind], *path: str | int) -> Kind | None:
        """Read the record at a path as ``read`` does; ``None`` if the field is ``None``."""
        return self.read(kind, *path)

    def _array(self, path: str) -> np.ndarray | None:
        return read_array(self._entries, path) if path in self._arrays else None


def _arrays(record: object) -> dict[str, np.ndarray]:
    arrays: dict[str, np.ndarray] = {}

    def prepare(value: Any, path: str) -> Any:
        """Arrays leave null; numbers of NumPy are numbers, and paths the names of their files."""
        if isinstance(value, np.ndarray):
            arrays[path] = value
            return None
        if isinstance(value, np.generic):
            return value.item()
        return value.name if isinstance(value, Path) else value

    document = to_json(record, prepare)
    return {**arrays, _DOCUMENT: np.frombuffer(json.dumps(document).encode(), np.uint8)}
