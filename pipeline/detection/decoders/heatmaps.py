"""Decoder of heatmaps of one person's crop, a map a point (ViTPose, HRNet).

Peaks are located between cells by the Taylor expansion of the blurred map's logarithm, as in DARK (Zhang et al., CVPR
2020). The first and the last cell are at the first and the last pixel of the input, as in UDP (Huang et al., CVPR
2020).
"""

import cv2
import numpy as np
from jaxtyping import Float

_BLUR_CELLS = 11
_LEAST = 1e-10


def decode_heatmaps(
    maps: Float[np.ndarray, "points rows columns"], input_px: tuple[int, int]
) -> tuple[Float[np.ndarray, "points 2"], Float[np.ndarray, " points"]]:
    """Decode the points of one crop.

    ``maps`` are confidences of cells, ``input_px`` is the size of the network's input. Returns pixels of the input, and
    confidences in [0, 1].
    """
    num_rows, num_columns = maps.shape[1:]
    rows, columns = np.divmod(maps.reshape(len(maps), -1).argmax(1), num_columns)
    cells = np.array(
        [_refine(each, int(row), int(column)) for each, row, column in zip(maps, rows, columns, strict=True)]
    )
    pixels_per_cell = (np.array(input_px) - 1) / (num_columns - 1, num_rows - 1)
    return cells.reshape(-1, 2) * pixels_per_cell, maps.max((1, 2)).astype(np.float64).clip(0, 1)


def _refine(heat: Float[np.ndarray, "rows columns"], row: int, column: int) -> tuple[float, float]:
    """Position (x, y) of a peak in cells."""
    num_rows, num_columns = heat.shape
    if not (1 <= row < num_rows - 1 and 1 <= column < num_columns - 1):
        return float(column), float(row)
    blurred = cv2.GaussianBlur(heat.astype(np.float64), (_BLUR_CELLS, _BLUR_CELLS), 0)
    around = np.log(blurred[row - 1 : row + 2, column - 1 : column + 2].clip(_LEAST))
    slope = np.array([around[1, 2] - around[1, 0], around[2, 1] - around[0, 1]]) / 2
    mixed = (around[2, 2] - around[2, 0] - around[0, 2] + around[0, 0]) / 4
    curvature = np.array(
        [
            [around[1, 2] - 2 * around[1, 1] + around[1, 0], mixed],
            [mixed, around[2, 1] - 2 * around[1, 1] + around[0, 1]],
        ]
    )
    # A maximum curves downwards along both axes; anything else is a flat map.
    if curvature[0, 0] >= 0 or np.linalg.det(curvature) <= 0:
        return float(column), float(row)
    step = np.clip(-np.linalg.solve(curvature, slope), -1, 1)
    return float(column + step[0]), float(row + step[1])
