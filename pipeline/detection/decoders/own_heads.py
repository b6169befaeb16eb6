"""Decoders of heads of own networks: SimCC of one crop, and RTMO of a whole image."""

import numpy as np
from jaxtyping import Float

_MIN_BODY_SCORE = 0.3


def decode_simcc(
    bins_x: Float[np.ndarray, "points columns"], bins_y: Float[np.ndarray, "points rows"], input_px: tuple[int, int]
) -> tuple[Float[np.ndarray, "points 2"], Float[np.ndarray, " points"]]:
    """Decode the points of one crop: coordinates as classes, one row of bins an axis (Li et al., ECCV 2022).

    RTMPose and RTMW have this head.

    Parameters
    ----------
    bins_x, bins_y
        Confidence of each bin; the bins divide the input's width and height evenly.
    input_px
        Width and height of the network's input.

    Returns
    -------
        Pixels of the input, and confidences in [0, 1]: of the less certain axis.
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
