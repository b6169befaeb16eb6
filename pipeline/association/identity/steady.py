"""Steady places of joints: medians over time, with gaps filled between their neighbours."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import median_filter

# Half of the time over which the median of a joint's places is taken: single frames of hard motion are wrong.
_STEADY_S = 0.1
# Longest time without a joint over which its place is expected between its neighbours in time.
_LONGEST_GAP_S = 1.0

REACH_S = _STEADY_S + _LONGEST_GAP_S / 2
"""Time on either side of a frame on which its steady place depends at most."""


def steady_places(
    xyz_m: Float[np.ndarray, "frames joints 3"], is_known: Bool[np.ndarray, "frames joints"], frame_rate_hz: float
) -> Float[np.ndarray, "frames joints 3"]:
    """Medians of joints' places over a fifth of a second, in metres; NaN where a joint is far from any known place.

    ``xyz_m`` may be anything where ``is_known`` is false.
    """
    rows = np.arange(len(xyz_m))
    filled_m = np.full(xyz_m.shape, np.nan)
    for joint in range(xyz_m.shape[1]):
        known = np.flatnonzero(is_known[:, joint])
        if len(known):
            for axis in range(3):
                filled_m[:, joint, axis] = np.interp(rows, known, xyz_m[known, joint, axis])
    size = 2 * round(_STEADY_S * frame_rate_hz) + 1
    steady_m = median_filter(np.nan_to_num(filled_m), size=(size, 1, 1), mode="nearest")
    return np.where(_near_in_time(is_known, _LONGEST_GAP_S * frame_rate_hz)[..., None], steady_m, np.nan)


def _near_in_time(is_known: Bool[np.ndarray, "frames joints"], longest_gap: float) -> Bool[np.ndarray, "frames joints"]:
    """Frames with a known place of a joint at most half a gap away on one side."""
    rows = np.arange(len(is_known))[:, None]
    before = np.maximum.accumulate(np.where(is_known, rows, -np.inf), axis=0)
    after = np.minimum.accumulate(np.where(is_known, rows, np.inf)[::-1], axis=0)[::-1]
    return np.asarray(np.minimum(rows - before, after - rows) <= longest_gap / 2)
