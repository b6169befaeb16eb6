"""Compiled integration of part affinity fields along segments."""

from typing import no_type_check

import numpy as np

from pipeline.core.runtime.jit import kernel

_NUM_SAMPLES = 10
_ZERO, _ONE = 128.0, 127.0


@kernel
@no_type_check
def integrate(fields, limb, begin, end, agreeing, mean, share):
    """Mean dot product of a field with the unit vector along each segment, and the share of samples that agree.

    ``geometry.fields.connectivity`` documents the arguments; ``mean`` and ``share`` are outputs.
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
