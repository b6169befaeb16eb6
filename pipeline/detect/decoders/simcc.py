"""Decoder of SimCC: coordinates as classes, one row of bins an axis (Li et al., ECCV 2022; RTMPose, RTMW)."""

import numpy as np
from jaxtyping import Float


def decode_simcc(
    bins_x: Float[np.ndarray, "points columns"], bins_y: Float[np.ndarray, "points rows"], input_px: tuple[int, int]
) -> tuple[Float[np.ndarray, "points 2"], Float[np.ndarray, " points"]]:
    """Decode the points of one crop.

    Parameters
    ----------
    bins_x, bins_y
        Confidence of each bin; the bins divide the input's width and height evenly.
    input_px
        Width and height of the network's input.

    Returns
    -------
        Pixels of the input, and confidences in [0, 1]: those of the less certain axis.
    """
    columns, rows = bins_x.argmax(1), bins_y.argmax(1)
    points_px = np.stack([columns * (input_px[0] / bins_x.shape[1]), rows * (input_px[1] / bins_y.shape[1])], axis=-1)
    return points_px, np.minimum(bins_x.max(1), bins_y.max(1)).astype(np.float64).clip(0, 1)
