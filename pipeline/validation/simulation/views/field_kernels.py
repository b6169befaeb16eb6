"""Compiled loops that draw heatmaps and part affinity fields from points."""

from typing import no_type_check

import numpy as np

from pipeline.core.runtime.jit import kernel


@kernel
@no_type_check
def draw_peaks(joint, cells, amplitude, sigma, maps):
    """Draw a Gaussian for each point; overlapping Gaussians give their maximum, as in OpenPose's training.

    Joint, position (x, y) in cells, and height of each peak are (n,), (n, 2), (n,); ``sigma`` is in cells. The heatmaps
    ``maps`` (joints, height, width) are changed in place.
    """
    height, width = maps.shape[1], maps.shape[2]
    reach = 4.0 * sigma
    for k in range(len(joint)):
        x, y = cells[k, 0], cells[k, 1]
        first_row, last_row = max(int(y - reach), 0), min(int(y + reach) + 2, height)
        first_column, last_column = max(int(x - reach), 0), min(int(x + reach) + 2, width)
        for row in range(first_row, last_row):
            for column in range(first_column, last_column):
                squared = (column - x) * (column - x) + (row - y) * (row - y)
                value = amplitude[k] * np.exp(-0.5 * squared / (sigma * sigma))
                maps[joint[k], row, column] = max(maps[joint[k], row, column], value)


@kernel
@no_type_check
def draw_limbs(limb, begin, end, amplitude, radius, fields, count):
    """Draw the unit vector of each limb along the limb; overlapping limbs give their mean.

    Parameters
    ----------
    limb, begin, end, amplitude
        Field, end points (x, y) in cells, and strength of each limb: (n,), (n, 2), (n, 2), (n,).
    radius
        Half of a limb's width, in cells.
    fields
        Zeros (limbs, 2, height, width), changed in place.
    count
        Work array, zeros (limbs, height, width).
    """
    height, width = fields.shape[2], fields.shape[3]
    for k in range(len(limb)):
        x0, y0, x1, y1 = begin[k, 0], begin[k, 1], end[k, 0], end[k, 1]
        along_x, along_y = x1 - x0, y1 - y0
        length = max(np.sqrt(along_x * along_x + along_y * along_y), 1e-6)
        unit_x, unit_y = along_x / length, along_y / length
        first_row, last_row = max(int(min(y0, y1) - radius), 0), min(int(max(y0, y1) + radius) + 2, height)
        first_column, last_column = max(int(min(x0, x1) - radius), 0), min(int(max(x0, x1) + radius) + 2, width)
        for row in range(first_row, last_row):
            for column in range(first_column, last_column):
                offset_x, offset_y = column - x0, row - y0
                along = offset_x * unit_x + offset_y * unit_y
                across = abs(offset_x * unit_y - offset_y * unit_x)
                if -radius <= along <= length + radius and across <= radius:
                    fields[limb[k], 0, row, column] += amplitude[k] * unit_x
                    fields[limb[k], 1, row, column] += amplitude[k] * unit_y
                    count[limb[k], row, column] += 1.0
    for number in range(fields.shape[0]):
        for row in range(height):
            for column in range(width):
                if count[number, row, column] > 1.0:
                    fields[number, 0, row, column] /= count[number, row, column]
                    fields[number, 1, row, column] /= count[number, row, column]
