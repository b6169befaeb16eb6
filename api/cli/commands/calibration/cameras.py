"""Calibration files on the command line: arguments, reading, and JSON of cameras."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from api.cli.options import known_units, known_up
from pipeline.calibration.contents import UNKNOWN_SIZE, CameraFile
from pipeline.calibration.registry import read_contents
from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import center_in_world

FileArgument = Annotated[Path, typer.Argument(metavar="FILE", help="Calibration in any supported format.")]


def read(file: Path, units: str | None, up: str = "z") -> CameraFile:
    """Read a calibration in a unit, and with an axis that points up, as they were typed.

    Raises ``InputError`` if there is no such unit or axis, or with all problems of the file.
    """
    return read_contents(file, known_units(units), known_up(up))


def camera_documents(cameras: Sequence[Camera]) -> list[dict[str, Any]]:
    """Cameras as JSON objects; lengths in metres."""
    return [
        {
            "name": camera.name,
            "size_px": None if camera.size_px == UNKNOWN_SIZE else list(camera.size_px),
            "matrix": camera.matrix.tolist(),
            "lens": camera.lens,
            "distortion": camera.distortion.tolist(),
            "rotation": camera.cam_from_world.rotation.tolist(),
            "translation_m": camera.cam_from_world.translation_m.tolist(),
            "position_m": np.round(center_in_world(camera), 6).tolist(),
        }
        for camera in cameras
    ]
