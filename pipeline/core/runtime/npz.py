"""NumPy archives: arrays as bytes or files, byte-identical for equal arrays.

Only plain arrays are written and read, no pickles: a file that was tampered with can't run code.
"""

import io
import math
import zlib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, BinaryIO
from zipfile import ZIP_DEFLATED, BadZipFile, ZipFile

import numpy as np
from numpy.lib import format as npy
from numpy.lib.npyio import NpzFile

from pipeline.core.runtime import large_arrays

_READ_BYTES = 2**20


def save_arrays(file: io.BufferedIOBase, arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays by name, compressed at the fastest level."""
    with ZipFile(file, "w", ZIP_DEFLATED, compresslevel=1) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
                npy.write_array(entry, np.asanyarray(array), allow_pickle=False)


def encode_arrays(arrays: Mapping[str, np.ndarray]) -> bytes:
    """Write arrays by name, compressed, into memory."""
    file = io.BytesIO()
    save_arrays(file, arrays)
    return file.getvalue()


def decode_arrays(content: bytes | BinaryIO) -> dict[str, np.ndarray]:
    """Read all arrays of an archive, or of an open file that holds it."""
    with open_archive(content) as archive:
        return {name: read_array(archive, name) for name in archive.files}


def read_array(archive: NpzFile, name: str) -> np.ndarray:
    """Read an array of an archive; a large one into a file, see ``large_arrays``."""
    entries: Any = archive.zip
    if (num_bytes := entries.getinfo(f"{name}.npy").file_size) < large_arrays.MIN_BYTES:
        return np.asarray(archive[name])
    with entries.open(f"{name}.npy") as file:
        read_header = npy.read_array_header_1_0 if npy.read_magic(file) == (1, 0) else npy.read_array_header_2_0
        shape, is_fortran, dtype = read_header(file)
        if is_fortran or dtype.hasobject:
            return np.asarray(archive[name])
        if math.prod(shape) * dtype.itemsize != num_bytes - file.tell():
            raise ValueError(f"The array {name} of an archive is not whole.")
        array = large_arrays.empty(shape, dtype)
        left = array.data.cast("B")
        while content := file.read(_READ_BYTES):
            left[: len(content)] = content
            left = left[len(content) :]
    return array


def open_archive(content: bytes | Path | BinaryIO) -> NpzFile:
    """Open an archive, or the file that holds it. An array is read when it is asked for."""
    opened: NpzFile = np.load(io.BytesIO(content) if isinstance(content, bytes) else content, allow_pickle=False)
    return opened


def read_untrusted_arrays(path: Path, names: Collection[str], max_bytes: int) -> dict[str, np.ndarray]:
    """Read arrays of a file that a stranger made; ``ValueError`` states the reason why they can't be read."""
    try:
        with path.open("rb") as file, open_archive(file) as archive:
            entries: Any = archive.zip
            is_small = sum(entry.file_size for entry in entries.infolist()) <= max_bytes
            arrays = {name: np.asarray(archive[name]) for name in names if is_small}
    except FileNotFoundError:
        raise ValueError("it does not exist") from None
    except (OSError, ValueError, LookupError, TypeError, MemoryError, EOFError, RuntimeError, BadZipFile, zlib.error):
        raise ValueError(f"it lacks one of the arrays {', '.join(names)}, or is damaged") from None
    if not is_small:
        raise ValueError("it is too large")
    return arrays
