"""Origin of files whose numbers have single precision: near the cameras, where the world's is far away."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import center_in_world

# Within this distance numbers of single precision are less than 0.04 mm off.
_NEAR_M = 1000.0


def file_origin_m(cameras: Sequence[Camera], near_m: float = _NEAR_M) -> Float[np.ndarray, " 3"]:
    """World position that is the origin of files of single precision, in whole metres.

    The world's origin, unless a camera is farther than ``near_m`` from it, by default a kilometre, as in survey
    coordinates: then the median of the cameras' positions. Numbers of single precision at 5,000 km would be off by up
    to 25 cm.
    """
    centers_m = np.array([center_in_world(camera) for camera in cameras])
    if np.abs(centers_m).max(initial=0.0) <= near_m:
        return np.zeros(3)
    return np.round(np.median(centers_m, axis=0))
