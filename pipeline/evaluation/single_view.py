"""Single-view tracker of boxes by overlap: baseline of cross-view tracking.

After Bochinski, Eiselein and Sikora, "High-speed tracking-by-detection without using image information" (AVSS 2017): a
detection continues the track whose last box it overlaps most, and a track without a detection ends.
"""

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment

from pipeline.evaluation.mot import box_overlap

_MIN_OVERLAP = 0.5


def track_boxes(frame: Int[np.ndarray, " n"], box_px: Float[np.ndarray, "n 4"]) -> Int[np.ndarray, " n"]:
    """Number the tracks of one camera's detections.

    Parameters
    ----------
    frame
        Frame number of each detection, ascending.
    box_px
        x0, y0, x1, y1 around each body.

    Returns
    -------
        Number of the track of each detection, from 0.
    """
    identity = np.empty(len(frame), int)
    num_tracks, before = 0, np.empty(0, int)
    for number in range(int(frame.max(initial=-1)) + 1):
        rows = np.flatnonzero(frame == number)
        overlap = box_overlap(box_px[before], box_px[rows])
        left, right = linear_sum_assignment(overlap, maximize=True)
        follows = overlap[left, right] >= _MIN_OVERLAP
        identity[rows] = -1
        identity[rows[right[follows]]] = identity[before[left[follows]]]
        new = rows[identity[rows] < 0]
        identity[new] = num_tracks + np.arange(len(new))
        num_tracks += len(new)
        before = rows
    return identity
