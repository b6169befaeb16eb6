"""Unit of a calibration's lengths, where neither its format nor the user states it."""

from collections.abc import Sequence

import numpy as np

from pipeline.calibration.contents import UNITS_M, Units
from pipeline.data.cameras import Camera
from pipeline.geometry.camera import center_in_world

_NAMES = {"m": "metres", "cm": "centimetres", "mm": "millimetres"}
# Largest distance in metres between cameras that film the same people, at which a number is taken as metres unasked.
_MAX_EXTENT_M = 50.0
# Distance at least that lengths are taken as millimetres, not as centimetres.
_MIN_EXTENT_M = 1.0


def likely_unit(cameras: Sequence[Camera]) -> Units:
    """Unit in which the cameras are as far apart as those of a rig for people: the metre, if that is possible.

    Parameters
    ----------
    cameras
        Cameras in the unit of the file.
    """
    extent = _extent(cameras)
    if extent <= _MAX_EXTENT_M:
        return "m"
    return "mm" if extent * UNITS_M["mm"] >= _MIN_EXTENT_M else "cm"


def candidates(cameras: Sequence[Camera], unit: Units) -> str:
    """Sentence with the place of the farthest camera in a unit and in metres."""
    far = max(cameras, key=lambda camera: float(np.linalg.norm(center_in_world(camera))))
    distance = float(np.linalg.norm(center_in_world(far)))
    return (
        f"The file does not state the unit of its lengths: camera {far.name} is {_shown(distance * UNITS_M[unit])} m "
        f"from the origin if they are {_NAMES[unit]}, or {_shown(distance)} m if they are metres."
    )


def _extent(cameras: Sequence[Camera]) -> float:
    """Largest distance between two cameras; of one camera, from the origin."""
    centers = np.array([center_in_world(camera) for camera in cameras])
    if len(centers) == 1:
        return float(np.linalg.norm(centers))
    return float(np.linalg.norm(centers[:, None] - centers[None], axis=-1).max())


def _shown(distance_m: float) -> str:
    return f"{distance_m:,.0f}" if distance_m >= 100 else f"{distance_m:.2g}"
