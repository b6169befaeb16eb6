"""EasyMocap's ``intri.yml`` and ``extri.yml``, joined: one mapping, whose keys end with the name of the camera.

Its documentation asks for metres.
"""

from collections.abc import Mapping
from itertools import islice
from typing import Any

from pipeline.calibration.contents import CameraFile
from pipeline.calibration.readers.fields import read_camera
from pipeline.calibration.reading import Reading
from pipeline.calibration.validate import MAX_CAMERAS

# Starts of the keys of a camera by field, those first that count where there are several.
_PREFIXES = {"K": ("K",), "dist": ("dist", "D"), "R": ("Rot", "R"), "T": ("T",), "W": ("W",), "H": ("H",)}


def is_rig(fields: Mapping[str, Any]) -> bool:
    """Return whether a mapping has a matrix ``K_name``."""
    return any(key.startswith("K_") and isinstance(value, list) for key, value in fields.items())


def read(fields: Mapping[str, Any], file: str) -> CameraFile:
    """Read the cameras of a mapping; ``InputError`` lists all its problems."""
    reading = Reading(file)
    starts = [f"{prefix}_" for field in ("K", "R", "T") for prefix in _PREFIXES[field]]
    # A camera may have the intrinsics alone, or the extrinsics.
    names = dict.fromkeys(
        key.removeprefix(start)
        for key, value in fields.items()
        for start in starts
        if key.startswith(start) and isinstance(value, list)
    )
    raw = [read_camera(name, _fields_of(name, fields), reading) for name in islice(names, MAX_CAMERAS + 1)]
    return reading.contents("EasyMocap", raw, None)


def _fields_of(name: str, fields: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of one camera without its name."""
    found = {
        field: next((fields[key] for prefix in prefixes if (key := f"{prefix}_{name}") in fields), None)
        for field, prefixes in _PREFIXES.items()
    }
    return {field: value for field, value in found.items() if value is not None}
