"""Choose the reader of a calibration file, and read it."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal

from pipeline.calibration import json_formats, qca, toml_format
from pipeline.data import Camera, read_only
from pipeline.errors import InputError, Problem
from pipeline.geometry.rigid import Rigid3

Units = Literal["m", "cm", "mm"]

UNITS_M: Mapping[Units, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001}

# 128 cameras take about 200 kB in the most verbose format.
MAX_BYTES = 4 * 2**20

_BY_ENDING: Mapping[str, Callable[[bytes, str], tuple[Camera, ...]]] = {
    ".toml": toml_format.read,
    ".json": json_formats.read,
    ".xml": qca.read,
    ".qca": qca.read,
}


def _reader(name: str, content: bytes) -> Callable[[bytes, str], tuple[Camera, ...]] | None:
    """Choose the reader by the file's ending, or by its first character (Qualisys names XML files ``.txt``)."""
    head = content.lstrip(b"\xef\xbb\xbf \t\r\n")[:1]
    return _BY_ENDING.get(Path(name).suffix.lower()) or {b"<": qca.read, b"{": json_formats.read}.get(head)


def _has_known_unit(reader: Callable[[bytes, str], tuple[Camera, ...]], content: bytes) -> bool:
    """Return whether the format determines the unit: millimetres of Qualisys, metres of ``translation_m``."""
    return reader is qca.read or (reader is json_formats.read and b'"translation_m"' in content)


def _scaled(camera: Camera, unit_m: float) -> Camera:
    moved = Rigid3(camera.cam_from_world.rotation, read_only(camera.cam_from_world.translation_m * unit_m))
    return replace(camera, cam_from_world=moved)


def read_calibration(path: Path, units: Units = "m") -> tuple[Camera, ...]:
    """Read cameras from a file in any supported format.

    Parameters
    ----------
    units
        Unit of the lengths in the file, for formats that don't determine it.

    Returns
    -------
        Cameras in the order of the file, with lengths in metres.

    Raises
    ------
    InputError
        With all problems of the file.
    """
    file = path.name

    def refuse(code: str, message: str, hint: str | None = None) -> InputError:
        return InputError([Problem(code, message, file=file, hint=hint)])

    try:
        if not path.is_file():
            raise refuse("calibration_missing", "The calibration file does not exist.")
        num_bytes = path.stat().st_size
        if num_bytes > MAX_BYTES:
            raise refuse(
                "calibration_too_large",
                f"The file has {num_bytes / 2**20:.0f} MiB; at most {MAX_BYTES // 2**20} MiB are allowed.",
                "Check that it is the calibration file.",
            )
        content = path.read_bytes()
    except OSError as error:
        raise refuse("calibration_unreadable", "The file can't be read.", "Check its permissions.") from error
    reader = _reader(file, content)
    if reader is None:
        raise refuse(
            "calibration_format",
            "The format of the calibration file is not supported.",
            "Use Qualisys QCA (XML), Caliscope/anipose TOML, or JSON.",
        )
    cameras = reader(content, file)
    if units == "m":
        return cameras
    if _has_known_unit(reader, content):
        raise refuse(
            "calibration_units", f"The format determines the unit of lengths; it is not {units}.", "Omit the units."
        )
    return tuple(_scaled(camera, UNITS_M[units]) for camera in cameras)
