"""Heatmaps of landmarks, read in a window around an expected position."""

import numpy as np
from jaxtyping import Float

_REACH_CELLS = 3
"""Cells of the window on each side of its central cell: the window of MediaPipe, 7 x 7."""


def read_near(
    logits: Float[np.ndarray, "maps height width"], expected: Float[np.ndarray, "maps 2"]
) -> tuple[Float[np.ndarray, "maps 2"], Float[np.ndarray, " maps"]]:
    """Read each heatmap around an expected position: the mean of the window's cells, weighted by their heat.

    Parameters
    ----------
    logits
        Heatmaps before the sigmoid.
    expected
        Positions (x, y) in cells; the centre of the first cell is (0, 0). NaN for a position that is not known.

    Returns
    -------
        Positions (x, y) in cells, NaN where the expected position is NaN or outside of the map; and the greatest heat
        in the window, in [0, 1], 0 there.
    """
    height, width = logits.shape[1:]
    known = np.asarray(((expected >= -0.5) & (expected < (width - 0.5, height - 0.5))).all(-1))
    central = np.rint(np.where(known[:, None], expected, 0.0)).astype(np.int64)
    steps = np.arange(-_REACH_CELLS, _REACH_CELLS + 1)
    columns, rows = central[:, :1] + steps, central[:, 1:] + steps
    is_inside = ((rows >= 0) & (rows < height))[:, :, None] & ((columns >= 0) & (columns < width))[:, None, :]
    maps = np.arange(len(logits))[:, None, None]
    window = logits[maps, rows.clip(0, height - 1)[:, :, None], columns.clip(0, width - 1)[:, None, :]]
    heat = np.where(is_inside & known[:, None, None], _sigmoid(window.astype(np.float64)), 0.0)
    total = heat.sum((1, 2))
    weight = np.where(known, total, np.nan)
    position = np.stack([(heat.sum(1) * columns).sum(1), (heat.sum(2) * rows).sum(1)], axis=-1) / weight[:, None]
    return position, heat.max((1, 2))


def _sigmoid(logits: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    return 1 / (1 + np.exp(-logits.clip(-60, 60)))
