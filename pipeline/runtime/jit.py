"""Compilation of numeric kernels to machine code by numba, and aligned records for them.

Compiled code is cached on disk, in a folder for each version of the kernels' sources: numba itself would miss changes
in functions that a kernel calls from another file. ``python -m pipeline.runtime.warm_up`` compiles all kernels.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import numba
import numpy as np

from pipeline.runtime.kernel_cache import cache_folder

_CACHE_LINE = 64
_Function = TypeVar("_Function", bound=Callable[..., object])

_FOLDER = cache_folder()
if _FOLDER is not None:
    numba.config.CACHE_DIR = str(_FOLDER)  # type: ignore[attr-defined]

_OPTIONS: dict[str, Any] = {
    "cache": _FOLDER is not None,
    "error_model": "numpy",
    # NaN keeps its meaning; sums may be reordered, so that loops over joints are vectorised.
    "fastmath": {"reassoc", "contract", "arcp", "nsz"},
    # Kernels allocate nothing, so they need no reference counting, which took a fifth of the tracker's time.
    "_nrt": False,
}


def kernel(function: _Function) -> _Function:
    """Compile a function of numbers and arrays at its first call; the function must not allocate arrays."""
    compiled: _Function = numba.njit(function, **_OPTIONS)
    return compiled


def round_up(num_joints: int) -> int:
    """Number of lanes for joints: the next multiple of four, the width of vector instructions."""
    return -(-num_joints // 4) * 4


def record_dtype(*fields: tuple[Any, ...]) -> np.dtype:
    """Make a record type for kernels, padded to cache lines; fields with lanes come first, aligned to cache lines."""
    plain = np.dtype(list(fields), align=True)
    return np.dtype([*fields, ("padding", np.uint8, (-plain.itemsize % _CACHE_LINE or _CACHE_LINE,))], align=True)


def zero_records(shape: int | tuple[int, ...], dtype: np.dtype) -> np.ndarray:
    """Allocate records of zeros, each at the start of a cache line."""
    num_bytes = int(np.prod(shape)) * dtype.itemsize
    raw = np.zeros(num_bytes + _CACHE_LINE, np.uint8)
    start = -raw.ctypes.data % _CACHE_LINE
    return raw[start : start + num_bytes].view(dtype).reshape(shape)
