"""EasyMocap's ``intri.yml`` and ``extri.yml``, joined: one mapping, whose keys end with the name of the camera.

Its documentation asks for metres.

Rows of the table of formats:

| EasyMocap | `.zip` with `intri.yml` and `extri.yml`; or a `.yml` with both, one after the other | `units` | as
calibrated |
"""

from collections.abc import Mapping
from itertools import islice
from typing import Any

from pipeline.calibration.contents import CameraFile
from pipeline.calibration.readers.fields import read_camera
from pipeline.calibration.reading import Reading
from pipeline.calibration.validate import MAX_CAMERAS
from pipeline.core.errors import InputError, Problem
from pipeline.core.problems.session_codes import CALIBRATION_EMPTY

# Starts of the keys whose values name a camera.
_STARTS = ("K_", "R_", "Rot_", "T_")


def is_rig(fields: Mapping[str, Any]) -> bool:
    """Return whether a mapping has a matrix ``K_name`` or ``Rot_name``."""
    return any(key.startswith(("K_", "Rot_")) and isinstance(value, list) for key, value in fields.items())


def read(fields: Mapping[str, Any], file: str) -> CameraFile:
    """Read the cameras of a mapping; ``InputError`` lists all its problems."""
    reading = Reading(file)
    # A camera may have the intrinsics alone, or the extrinsics.
    names = dict.fromkeys(
        key.removeprefix(start)
        for key, value in fields.items()
        for start in _STARTS
        if key.startswith(start) and isinstance(value, list)
    )
    if not any(key.startswith("K_") for key in fields):
        message = f"The file has the extrinsics of {len(names)} cameras and no camera matrix."
        hint = "Pack this file and the one with the intrinsics (intri.yml) into one zip."
        raise InputError([Problem(CALIBRATION_EMPTY, message, file=file, hint=hint)])
    by_camera: dict[str, dict[str, Any]] = {name: {} for name in islice(names, MAX_CAMERAS + 1)}
    beside: dict[str, Any] = {}
    # A name may end as another one does: `K_cam_1` is of `cam_1`, not of `1`.
    longest_first = sorted(by_camera, key=len, reverse=True)
    for key, value in fields.items():
        name = next((name for name in longest_first if key.endswith(f"_{name}")), None)
        (beside if name is None else by_camera[name])[key.removesuffix(f"_{name}")] = value
    reading.pass_over(beside, frozenset({"names"}))
    for of_camera in by_camera.values():
        # The matrix counts where there is a vector, too.
        of_camera["R"] = of_camera.pop("Rot", of_camera.get("R"))
    raw = [read_camera(name, of_camera, reading) for name, of_camera in by_camera.items()]
    return reading.contents("EasyMocap", raw, None)
