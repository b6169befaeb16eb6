"""Large arrays in temporary files without names, so that long takes need no more memory than short ones.

The system writes their pages to disk when memory is short; see ``resources.map_file``. Arrays below ``MIN_BYTES`` are
in memory as usual.
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import DTypeLike

from pipeline.core.runtime.resources import map_file, release_pages

MIN_BYTES = 2**20
"""Size from which on arrays are in files."""
_BLOCK = 512


def empty(shape: tuple[int, ...], dtype: DTypeLike = np.float64) -> np.ndarray:
    """Make an array; a large one takes the pages of others out. Raises ``OSError`` if the disk is full."""
    num_bytes = math.prod(shape) * np.dtype(dtype).itemsize
    if num_bytes < MIN_BYTES:
        return np.empty(shape, dtype)
    release_pages()
    return np.frombuffer(map_file(num_bytes), dtype).reshape(shape)


def full(shape: tuple[int, ...], value: float, dtype: DTypeLike = np.float64) -> np.ndarray:
    """Make an array of equal values."""
    array = empty(shape, dtype)
    array[...] = value
    return array


def copy(array: np.ndarray) -> np.ndarray:
    """Copy an array."""
    copied = empty(array.shape, array.dtype)
    copied[...] = array
    return copied


def blocks(num_rows: int) -> Iterator[slice]:
    """Blocks of rows that are worked on at once, to bound the memory of the steps between."""
    return (slice(start, min(start + _BLOCK, num_rows)) for start in range(0, num_rows, _BLOCK))


def concatenate(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """Concatenate arrays of one type along their first axis."""
    shape = sum(map(len, arrays)), *arrays[0].shape[1:]
    return np.concatenate(arrays, out=empty(shape, np.result_type(*{array.dtype for array in arrays})))
