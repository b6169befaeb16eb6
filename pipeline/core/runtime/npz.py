"""NumPy archives: arrays as bytes or files, byte-identical for equal arrays.

Only plain arrays are written and read, no pickles: a file that was tampered with can't run code.
"""

import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.lib.npyio import NpzFile


def save_arrays(file: io.BufferedIOBase, arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays by name, compressed."""
    np.savez_compressed(file, allow_pickle=False, **arrays)


def encode_arrays(arrays: Mapping[str, np.ndarray]) -> bytes:
    """Write arrays by name, compressed, into memory."""
    file = io.BytesIO()
    save_arrays(file, arrays)
    return file.getvalue()


def decode_arrays(content: bytes) -> dict[str, np.ndarray]:
    """Read all arrays of an archive."""
    with open_archive(content) as archive:
        return dict(archive)


def open_archive(content: bytes | Path) -> NpzFile:
    """Open an archive, or the file that holds it. An array is read when it is asked for."""
    opened: NpzFile = np.load(content if isinstance(content, Path) else io.BytesIO(content), allow_pickle=False)
    return opened
