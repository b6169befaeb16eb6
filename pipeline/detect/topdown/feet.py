"""Heels and big toes of a body from BlazePose's landmarks."""

import numpy as np
from jaxtyping import Float

from pipeline.detect.topdown.blazepose import LANDMARK, SURE_PEAK, PoseOutputs, score_of_peak
from pipeline.joints import BODY_FEET, COCO_17, SIDES

FOOT_JOINTS = BODY_FEET.names[len(COCO_17.names) :]
"""Joints of the feet, in the order of ``BODY_FEET``."""
# Largest distance between the ankles of both networks, as a share of the body's size.
_MAX_ANKLE_DISTANCE = 0.06

_LANDMARK_NAMES = {"heel": "heel", "big_toe": "foot_index"}
_SIDE_AND_PART = tuple(name.split("_", 1) for name in FOOT_JOINTS)
_LANDMARKS = [LANDMARK[f"{side}_{_LANDMARK_NAMES[part]}"] for side, part in _SIDE_AND_PART]
_SIDE = [SIDES.index(side) for side, _ in _SIDE_AND_PART]
_ANKLES = [LANDMARK[f"{side}_ankle"] for side in SIDES]


def read_feet(
    pose: PoseOutputs, ankles_px: Float[np.ndarray, "sides 2"], size_px: float
) -> tuple[Float[np.ndarray, "joints 2"], Float[np.ndarray, " joints"]]:
    """Read heels and big toes.

    A foot whose ankle is not where the body's ankle is may be another person's, and is left out.

    Parameters
    ----------
    ankles_px
        Left and right ankle of the body in pixels of the image, NaN where missing.
    size_px
        Size of the body in pixels of the image; see ``blazepose.body_size_px``.

    Returns
    -------
        ``FOOT_JOINTS`` in pixels of the image, NaN where missing, and their scores, 0 there.
    """
    points_px, peak = pose.refined()
    distance_px = np.linalg.norm(points_px[_ANKLES] - ankles_px, axis=-1)
    is_own = (distance_px <= _MAX_ANKLE_DISTANCE * size_px)[_SIDE]
    is_found = is_own & (peak[_LANDMARKS] >= SURE_PEAK)
    return (
        np.where(is_found[:, None], points_px[_LANDMARKS], np.nan),
        np.where(is_found, score_of_peak(peak[_LANDMARKS]), 0.0),
    )
