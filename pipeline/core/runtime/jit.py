"""Compilation of numeric kernels to machine code by numba, and aligned records for them.

Compiled code is cached on disk, in a folder for each version of the kernels' sources: numba itself would miss changes
in functions that a kernel calls from another file. ``python -m pipeline.run.warm_up`` compiles all kernels.
"""

import math
from collections.abc import Callable
from typing import Any, TypeVar

import numba
import numpy as np
from jaxtyping import Float
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

from pipeline.core.runtime.kernel_cache import cache_folder

_CACHE_LINE = 64
# Bodies without and with feet. Lanes of its own for each joint set would save no time of the tracker that can be
# measured, and cost a third of the time of compiling.
_LANES_OF_BODIES = (20, 28)
_MOST_PREFETCHED = 5 * _CACHE_LINE
_PREFETCH = ir.FunctionType(ir.VoidType(), [ir.PointerType(), *3 * [ir.IntType(32)]])
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


def inlined(function: _Function) -> _Function:
    """Compile a function as ``kernel`` does, always as a part of the kernels that call it.

    A kernel that is not inlined gets its arguments on the stack, one number at a time: some 60 for the arrays of the
    tracker's targets alone. In the innermost loops this takes longer than the work itself.
    """
    compiled: _Function = numba.njit(function, **_OPTIONS, forceinline=True)
    return compiled


@intrinsic
def prefetch_row(
    typing_context: object, array: types.Array, row: types.Integer
) -> tuple[object, Callable[[Any, Any, Any, Any], Any]]:
    """Start to load a row of a contiguous array into the processor's cache; for rows that are far from each other.

    A row that is out of bounds has no effect.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        view = make_array(signature.args[0])(context, builder, arguments[0])  # type: ignore[no-untyped-call]
        start = builder.ptrtoint(view.data, ir.IntType(64))
        row_bytes = builder.extract_value(view.strides, 0)
        at = builder.add(start, builder.mul(row_bytes, arguments[1]))
        pointer = ir.PointerType()
        function = builder.module.declare_intrinsic("llvm.prefetch", (pointer,), _PREFETCH)
        kind = [ir.Constant(ir.IntType(32), value) for value in (0, 3, 1)]  # for reading, into all caches, data
        for line in range(0, _MOST_PREFETCHED, _CACHE_LINE):
            builder.call(
                function, [builder.inttoptr(builder.add(at, ir.Constant(ir.IntType(64), line)), pointer), *kind]
            )
        return context.get_dummy_value()

    return types.void(array, types.int64), generate


def as_compiled(values: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Floats in the kind of array that kernels are compiled for in advance: contiguous and writable.

    Of another kind it is a copy; a kernel that gets a read-only array, or a view with steps, is compiled again.
    """
    return np.require(values, float, ("C", "W"))


def round_up(num_joints: int) -> int:
    """Number of lanes for joints: one of a few, as kernels are compiled for each, and a multiple of four.

    Vector instructions take four numbers or more at once.
    """
    return next((lanes for lanes in _LANES_OF_BODIES if lanes >= num_joints), -(-num_joints // 4) * 4)


def record_dtype(*fields: tuple[Any, ...]) -> np.dtype:
    """Make a record type for kernels, padded to cache lines; fields with lanes come first, aligned to cache lines."""
    plain = np.dtype(list(fields), align=True)
    return np.dtype([*fields, ("padding", np.uint8, (-plain.itemsize % _CACHE_LINE or _CACHE_LINE,))], align=True)


def zero_records(shape: int | tuple[int, ...], dtype: np.dtype) -> np.ndarray:
    """Allocate records of zeros, each at the start of a cache line."""
    num_bytes = (shape if isinstance(shape, int) else math.prod(shape)) * dtype.itemsize
    raw = np.zeros(num_bytes + _CACHE_LINE, np.uint8)
    start = -raw.ctypes.data % _CACHE_LINE
    return raw[start : start + num_bytes].view(dtype).reshape(shape)
