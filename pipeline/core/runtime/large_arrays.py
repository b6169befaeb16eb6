"""Large arrays in temporary files without names, so that long takes need no more memory than short ones.

The system writes their pages to disk when memory is short; see ``resources.map_file``. Memory is quicker: it holds
arrays below ``MIN_BYTES``, and the first others, up to ``MAX_HELD_BYTES`` in all.
"""

import math
from collections.abc import Iterator, Sequence
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import DTypeLike

from pipeline.core.runtime.resources import map_file, release_pages

MIN_BYTES = 2**20
"""Size from which on arrays may be in files."""
MAX_HELD_BYTES = 128 * 2**20
"""Size of all arrays of that size that are in memory at once."""
_BLOCK = 512
_held: WeakValueDictionary[int, np.ndarray] = WeakValueDictionary()


def empty(shape: tuple[int, ...], dtype: DTypeLike = np.float64) -> np.ndarray:
    """Make an array; one in a file takes the pages of others out. Raises ``OSError`` if the disk is full."""
    num_bytes = math.prod(shape) * np.dtype(dtype).itemsize
    if num_bytes < MIN_BYTES:
        return np.empty(shape, dtype)
    # Unlike an iterator the references are a list: other threads may make arrays meanwhile.
    held = (reference() for reference in _held.valuerefs())
    if num_bytes + sum(array.nbytes for array in held if array is not None) > MAX_HELD_BYTES:
        release_pages()
        return np.frombuffer(map_file(num_bytes), dtype).reshape(shape)
    array = np.empty(shape, dtype)
    _held[id(array)] = array
    return array


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
