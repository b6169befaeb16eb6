"""Contents of a calibration file: cameras, and what the format says of lengths and axes; the unit."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.core.options.job_choices import UNITS_M, Units
from pipeline.geometry.camera import center_in_world

UNKNOWN_SIZE = (0, 0)
"""Size of a camera's picture in formats that don't contain it; the video's size takes its place."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraFile:
    """Cameras of a file.

    Parameters
    ----------
    format
        Name of the format for users.
    cameras
        Cameras; lengths are metres if the format determines the unit, else in the file's unit.
    unit
        Unit of lengths in the file; ``None``: the format does not determine it.
    axes
        Axes of the file's world.
    notes
        Sentences for the user on what was assumed or left out.
    unposed
        Cameras of which the file has the intrinsics alone; their poses are the identity.

    Examples
    --------
    >>> CameraFile("Studio", (), "m").axes
    'as calibrated; Z must point up'
    """

    format: str
    cameras: tuple[Camera, ...]
    unit: Units | None
    axes: str = "as calibrated; Z must point up"
    notes: tuple[str, ...] = ()
    unposed: tuple[Camera, ...] = ()


def scaled(camera: Camera, factor: float) -> Camera:
    """Multiply the lengths of a camera's extrinsics."""
    pose = camera.cam_from_world
    return replace(camera, cam_from_world=Rigid3(pose.rotation, read_only(pose.translation_m * factor)))


_NAMES = {"m": "metres", "cm": "centimetres", "mm": "millimetres"}
# Largest distance in metres between cameras that film the same people, at which lengths are metres unasked.
_MAX_EXTENT_M = 50.0
# Distances in metres between the cameras of usual rigs, in the units that are asked for.
_USUAL_EXTENT_M = (0.1, 20.0)


def possible_units(cameras: Sequence[Camera]) -> tuple[Units, ...]:
    """Units in which the cameras, in the unit of their file, can be a rig for people, likeliest first.

    Lengths that can be metres are metres. Others may be millimetres or centimetres, and of a very large rig metres.
    """
    extent = _extent(cameras)
    if extent <= _MAX_EXTENT_M:
        return ("m",)
    smaller: tuple[Units, ...] = ("mm", "cm")
    lowest_m, highest_m = _USUAL_EXTENT_M
    usual = tuple(unit for unit in smaller if lowest_m <= extent * UNITS_M[unit] <= highest_m)
    return (*(usual or ("mm",)), "m")


def question(cameras: Sequence[Camera], units: Sequence[Units]) -> str:
    """Sentence with the distance of the farthest camera from the origin in each unit."""
    distances = [float(np.linalg.norm(center_in_world(camera))) for camera in cameras]
    far = int(np.argmax(distances))
    places = [f"{_shown(distances[far] * UNITS_M[unit])} m if they are {_NAMES[unit]}" for unit in units]
    return (
        f"The file does not state the unit of its lengths: camera {cameras[far].name} is {', '.join(places[:-1])}, or "
        f"{places[-1]}, from the origin."
    )


def _extent(cameras: Sequence[Camera]) -> float:
    """Largest distance between two cameras; of one camera, from the origin."""
    centers = np.array([center_in_world(camera) for camera in cameras])
    if len(centers) == 1:
        return float(np.linalg.norm(centers))
    return float(np.linalg.norm(centers[:, None] - centers[None], axis=-1).max())


def _shown(distance_m: float) -> str:
    return f"{distance_m:,.0f}" if distance_m >= 100 else f"{distance_m:.2g}"
