"""Compilation of numeric kernels to machine code, once a machine.

Compiled code is kept on disk, apart by the kernels' source: numba itself looks only at the file that a kernel stands
in, and would miss a change in another that it calls. ``python -m pipeline.runtime.warm_up`` compiles all of it.
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
    # NaN keeps its meaning; sums may be reordered, so that a loop can work on several joints at a time.
    "fastmath": {"reassoc", "contract", "arcp", "nsz"},
    # Kernels allocate nothing. So references need not be counted, which took a fifth of the tracker's time.
    "_nrt": False,
}


def kernel(function: _Function) -> _Function:
    """Compile a function of numbers and arrays at its first call; it must not allocate arrays."""
    compiled: _Function = numba.njit(function, **_OPTIONS)
    return compiled


def round_up(num_joints: int) -> int:
    """Joints and unused lanes behind them: a multiple of what a machine works on at a time."""
    return -(-num_joints // 4) * 4


def record_dtype(*fields: tuple[Any, ...]) -> np.dtype:
    """A record for kernels; vectors of lanes come before all else in it, so that none lies across two cache lines."""
    plain = np.dtype(list(fields), align=True)
    return np.dtype([*fields, ("padding", np.uint8, (-plain.itemsize % _CACHE_LINE or _CACHE_LINE,))], align=True)


def zero_records(shape: int | tuple[int, ...], dtype: np.dtype) -> np.ndarray:
    """Records that begin with a cache line each."""
    num_bytes = int(np.prod(shape)) * dtype.itemsize
    raw = np.zeros(num_bytes + _CACHE_LINE, np.uint8)
    start = -raw.ctypes.data % _CACHE_LINE
    return raw[start : start + num_bytes].view(dtype).reshape(shape)
