"""Decoders of heads of own networks: heatmaps and SimCC of one crop, and RTMO of a whole image."""

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


_MIN_BODY_SCORE = 0.3


def decode_simcc(
    bins_x: Float[np.ndarray, "points columns"], bins_y: Float[np.ndarray, "points rows"], input_px: tuple[int, int]
) -> tuple[Float[np.ndarray, "points 2"], Float[np.ndarray, " points"]]:
    """Decode the points of one crop: coordinates as classes, one row of bins an axis (Li et al., ECCV 2022).

    RTMPose and RTMW have this head.

    ``bins_x``, ``bins_y``: confidence of each bin; the bins divide the input's width and height evenly. ``input_px``:
    width and height of the network's input. Returns pixels of the input, and confidences in [0, 1]: of the less certain
    axis.
    """
    columns, rows = bins_x.argmax(1), bins_y.argmax(1)
    points_px = np.stack([columns * (input_px[0] / bins_x.shape[1]), rows * (input_px[1] / bins_y.shape[1])], axis=-1)
    return points_px, np.minimum(bins_x.max(1), bins_y.max(1)).astype(np.float64).clip(0, 1)


def decode_rtmo(
    boxes: Float[np.ndarray, "people 5"], keypoints: Float[np.ndarray, "people points 3"]
) -> tuple[Float[np.ndarray, "n points 2"], Float[np.ndarray, "n points"], Float[np.ndarray, " n"]]:
    """Decode the people of one image (Lu et al., CVPR 2024); duplicates were removed by the network.

    Boxes are x0, y0, x1, y1 and confidence, points x, y and confidence. Returns pixels of the network's input,
    confidences in [0, 1] of points and of people, in descending order.
    """
    order = np.argsort(-boxes[:, 4], kind="stable")
    chosen = order[boxes[order, 4] > _MIN_BODY_SCORE]
    joints_px = keypoints[chosen].astype(np.float64)
    return joints_px[..., :2], joints_px[..., 2].clip(0, 1), boxes[chosen, 4].astype(np.float64).clip(0, 1)
