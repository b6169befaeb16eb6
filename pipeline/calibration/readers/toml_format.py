"""Calibration of Caliscope, anipose, Pose2Sim and FreeMoCap (TOML): one section a camera.

``x = K (R X + t)``, R as a Rodrigues vector; older versions of Caliscope write the matrix. FreeMoCap's lengths are
millimetres; the unit of the others is the board's. Caliscope's own ``camera_array.toml`` has a section
``cameras.N`` a camera, the other programs a section at the top.

Rows of the table of formats:

| anipose, Pose2Sim, Caliscope's export for aniposelib | `.toml` | `units` | as calibrated |
| Caliscope | `.toml` with sections `[cameras.0]`, ... (`camera_array.toml`) | `units` | as calibrated; cameras are
called `cam_0`, ..., videos may be called `port_0` |
| FreeMoCap | `.toml` with FreeMoCap's `[metadata]` | mm; `units` if the size of the squares of the board is missing
or 1 | as calibrated |
"""

import tomllib
from collections.abc import Mapping
from dataclasses import replace
from itertools import islice
from typing import Any

from pipeline.calibration.contents import CameraFile
from pipeline.calibration.formats import reader
from pipeline.calibration.readers import qca
from pipeline.calibration.readers.fields import flat, read_rotation
from pipeline.calibration.reading import Reading
from pipeline.calibration.validate import MAX_CAMERAS, RawCamera
from pipeline.core.errors import InputError, Problem
from pipeline.core.parsing import UnreadableError, parse
from pipeline.core.problems.session_codes import CALIBRATION_UNREADABLE, UNSUPPORTED_LENS

_KNOWN = frozenset({"name", "size", "matrix", "distortions", "rotation", "translation", "fisheye"})
# Fields that are not the calibration: FreeMoCap's, with the extrinsics once more, and Caliscope's.
_PASSED_OVER = frozenset({"id", "index", "world_position", "world_orientation"}) | frozenset(
    {"cam_id", "port", "rotation_count", "error", "exposure", "grid_count", "ignore", "verified_resolutions"}
)
_FREEMOCAP_METADATA = frozenset({"charuco_square_size", "groundplane_calibration", "path_to_recorded_videos"})
# FreeMoCap's older default is a board of squares of length 1: lengths are then in squares.
_MIN_SQUARE_MM = 2.0
# Sections that are not cameras.
_IGNORED = frozenset({"metadata"})
# Parts of Qualisys's distortion that Pose2Sim writes, without and with a binning of two pixels.
_PARTS = (64, 128)
_NUM_OF_POSE2SIM = 4
# Older versions of Caliscope write a missing value as this text.
_NULL = "null"


@reader("TOML of Caliscope, anipose, Pose2Sim and FreeMoCap", suffixes=(".toml",))
def read(content: bytes, file: str) -> CameraFile:
    """Read the cameras of a TOML file; ``InputError`` lists all its problems."""
    try:
        sections = parse(_loads, content)
    except UnreadableError as error:
        message = "The file is not valid TOML, or a number in it is too long."
        raise InputError([Problem(CALIBRATION_UNREADABLE, message, file=file, hint="Export it again.")]) from error
    reading = Reading(file)
    arrayed = sections.get("cameras")
    if isinstance(arrayed, dict) and all(isinstance(section, dict) for section in arrayed.values()):
        # Videos are called cam_0, of older versions port_0.
        named = {f"cam_{number}": (f"port_{number}", section) for number, section in arrayed.items()}
        return reading.contents("Caliscope", _cameras(named, reading), None)
    named = {name: (name, section) for name, section in sections.items() if _is_camera(section)}
    reading.pass_over(sections, _IGNORED | named.keys())
    raw = _cameras(named, reading)
    bent = [camera for camera in raw if isinstance(camera.distortion, list) and any(camera.distortion)]
    parts = next((parts for parts in _PARTS if all(_is_of_qualisys(camera, parts) for camera in bent)), 1)
    if bent and parts > 1:
        message = f"Pose2Sim divided the distortion of the Qualisys cameras by {parts}: it is multiplied again"
        reading.notes.append(f"{file}: {message}.")
        raw = [
            replace(camera, distortion=[parts * number for number in camera.distortion])
            if isinstance(camera.distortion, list) and _is_of_qualisys(camera, parts)
            else camera
            for camera in raw
        ]
    return (
        reading.contents("FreeMoCap TOML", raw, "mm")
        if _is_freemocap(sections)
        else reading.contents("TOML", raw, None)
    )


def _is_of_qualisys(camera: RawCamera, parts: int) -> bool:
    """Return whether Pose2Sim wrote a camera from a Qualisys file: it writes sizes with decimals, and four numbers."""
    size, distortion = camera.size_px, camera.distortion
    numbers = [*(size if isinstance(size, list) else [None]), *distortion]
    is_pose2sim = len(distortion) == _NUM_OF_POSE2SIM and all(isinstance(number, float) for number in numbers)
    return is_pose2sim and qca.is_64th(distortion, parts)


def _is_camera(section: Any) -> bool:
    return isinstance(section, dict) and not _KNOWN.isdisjoint(section.keys() - {"name"})


def _cameras(sections: Mapping[str, tuple[str, Mapping[str, Any]]], reading: Reading) -> list[RawCamera]:
    """Cameras of sections, by the names of cameras without a name of their own."""
    ignored = [name for name, (_, section) in sections.items() if section.get("ignore") is True]
    reading.leave_out(ignored, "ignored by the file")
    # One camera above the limit suffices to report that there are too many.
    serving = islice((name for name in sections if name not in ignored), MAX_CAMERAS + 1)
    return [_raw(name, *sections[name], reading) for name in serving]


def _is_freemocap(sections: Mapping[str, Any]) -> bool:
    """Return whether FreeMoCap wrote the file, with a board whose squares it knows in millimetres."""
    metadata = sections.get("metadata")
    if not isinstance(metadata, dict):
        return False
    board = metadata.get("board")
    square = board.get("square_length_mm") if isinstance(board, dict) else None
    if square is None and not _FREEMOCAP_METADATA.isdisjoint(metadata):
        square = metadata.get("charuco_square_size", _MIN_SQUARE_MM)
    return isinstance(square, (int, float)) and square >= _MIN_SQUARE_MM


def _loads(content: bytes) -> dict[str, Any]:
    return tomllib.loads(content.decode("utf-8-sig"))


def _raw(default_name: str, title: str, section: Mapping[str, Any], reading: Reading) -> RawCamera:
    values = {field: value for field, value in section.items() if value != _NULL}
    name = values.get("name", default_name)
    if not isinstance(values.get("fisheye", False), bool):
        reading.complain(UNSUPPORTED_LENS, "The field fisheye must be true or false.", str(name), "fisheye")
    raw = RawCamera(
        name=name,
        size_px=values.get("size"),
        matrix=values.get("matrix"),
        distortion=flat(values.get("distortions", [])),
        rotation=read_rotation(values.get("rotation"), str(name), reading),
        translation_m=flat(values.get("translation")),
        section=title,
        lens="fisheye" if values.get("fisheye") is True else "standard",
    )
    reading.pass_over(values, _KNOWN | _PASSED_OVER, raw)
    return raw
