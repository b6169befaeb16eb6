"""Part affinity fields: storage as bytes, and connectivity of two points by a compiled loop.

Source: Cao et al., "Realtime multi-person 2D pose estimation using part affinity fields" (CVPR 2017), section 2.3.
"""

from typing import no_type_check

import numpy as np
from jaxtyping import Float, Int, UInt8

from pipeline.core.runtime.jit import kernel

_NUM_SAMPLES = 10
_ZERO, _ONE = 128.0, 127.0


@kernel
@no_type_check
def integrate(fields, limb, begin, end, agreeing, mean, share):
    """Mean dot product of a field with the unit vector along each segment, and the share of samples that agree.

    ``connectivity`` documents the arguments; ``mean`` and ``share`` are outputs.
    """
    height, width = fields.shape[2], fields.shape[3]
    for k in range(len(limb)):
        x0, y0, x1, y1 = begin[k, 0], begin[k, 1], end[k, 0], end[k, 1]
        along_x, along_y = x1 - x0, y1 - y0
        length = np.sqrt(along_x * along_x + along_y * along_y)
        inside = (
            min(x0, x1) >= -0.5 and min(y0, y1) >= -0.5 and max(x0, x1) < width - 0.5 and max(y0, y1) < height - 0.5
        )
        if not inside:  # NaN is not inside either
            mean[k] = np.nan
            share[k] = np.nan
            continue
        if length < 1e-6:
            mean[k] = 0.0
            share[k] = 0.0
            continue
        unit_x, unit_y = along_x / length, along_y / length
        total = 0.0
        agreed = 0
        for sample in range(_NUM_SAMPLES):
            part = sample / (_NUM_SAMPLES - 1)
            x = min(max(x0 + part * along_x, 0.0), width - 1.0)
            y = min(max(y0 + part * along_y, 0.0), height - 1.0)
            column, row = int(x), int(y)
            right, below = min(column + 1, width - 1), min(row + 1, height - 1)
            u, v = x - column, y - row
            value = 0.0
            for axis in range(2):
                upper = (1 - u) * fields[limb[k], axis, row, column] + u * fields[limb[k], axis, row, right]
                lower = (1 - u) * fields[limb[k], axis, below, column] + u * fields[limb[k], axis, below, right]
                unit = unit_x if axis == 0 else unit_y
                value += unit * ((1 - v) * upper + v * lower - _ZERO) / _ONE
            total += value
            agreed += value > agreeing
        mean[k] = total / _NUM_SAMPLES
        share[k] = agreed / _NUM_SAMPLES


# A sample of a field agrees with a segment if their dot product is above this threshold of OpenPose.
_AGREEING = 0.05


def quantise(pafs: Float[np.ndarray, "*batch"]) -> UInt8[np.ndarray, "*batch"]:
    """Quantise fields to bytes: 128 for 0, steps of 1 / 127, from -1 to 1."""
    return (np.clip(pafs, -1.0, 1.0) * 127.0 + 128.5).astype(np.uint8)


def connectivity(
    fields: UInt8[np.ndarray, "limbs 2 height width"],
    limb: Int[np.ndarray, " n"],
    begin: Float[np.ndarray, "n 2"],
    end: Float[np.ndarray, "n 2"],
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Connectivity score s of two image points (eq. 10), and the share of samples that agree with the segment.

    Fields are bytes of ``quantise``, and ``limb`` is the index of the field of each pair; its assumed start and end are
    x and y in cells. Both results are NaN where an end is NaN or outside of the map.
    """
    # Writeability is part of an array's type for numba; the kernel is compiled for read-only arrays.
    fields = fields.view()
    fields.flags.writeable = False
    mean, share = np.empty(len(limb)), np.empty(len(limb))
    integrate(fields, limb, begin, end, _AGREEING, mean, share)
    return mean, share
