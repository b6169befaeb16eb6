"""Contents of a calibration file: cameras, and what the format says of lengths and axes."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3

Units = Literal["m", "cm", "mm"]
Up = Literal["x", "-x", "y", "-y", "z", "-z"]
"""Axis of a file's world that points up."""

UNITS_M: Mapping[Units, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001}

UNKNOWN_SIZE = (0, 0)
"""Size of a camera's picture in formats that don't contain it; the video's size takes its place."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraFile:
    """Cameras of a file."""

    format: str  # Name of the format for users
    # Cameras; their lengths are metres if the format determines the unit, else in the file's unit
    cameras: tuple[Camera, ...]
    unit: Units | None  # Unit of lengths in the file; ``None``: the format does not determine it
    axes: str = "as calibrated; Z must point up"  # Axes of the file's world
    notes: tuple[str, ...] = ()  # Sentences for the user on what was assumed or left out
    unposed: tuple[Camera, ...] = ()  # Cameras of which the file has the intrinsics alone; their poses are the identity


def scaled(camera: Camera, factor: float) -> Camera:
    """Multiply the lengths of a camera's extrinsics."""
    pose = camera.cam_from_world
    return replace(camera, cam_from_world=Rigid3(pose.rotation, read_only(pose.translation_m * factor)))
