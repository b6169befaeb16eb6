"""Decoder of RTMO's exported outputs: boxes and keypoints of all people of an image (Lu et al., CVPR 2024)."""

import numpy as np
from jaxtyping import Float

_MIN_BODY_SCORE = 0.3


def decode_rtmo(
    boxes: Float[np.ndarray, "people 5"], keypoints: Float[np.ndarray, "people points 3"]
) -> tuple[Float[np.ndarray, "n points 2"], Float[np.ndarray, "n points"], Float[np.ndarray, " n"]]:
    """Decode the people of one image; duplicates were removed by the network.

    Parameters
    ----------
    boxes
        x0, y0, x1, y1 and confidence.
    keypoints
        x, y and confidence.

    Returns
    -------
        Pixels of the network's input, confidences in [0, 1] of points and of people, in descending order.
    """
    order = np.argsort(-boxes[:, 4], kind="stable")
    chosen = order[boxes[order, 4] > _MIN_BODY_SCORE]
    found = keypoints[chosen].astype(np.float64)
    return found[..., :2], found[..., 2].clip(0, 1), boxes[chosen, 4].astype(np.float64).clip(0, 1)
