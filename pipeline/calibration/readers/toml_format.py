"""Calibration of Caliscope, anipose, Pose2Sim and FreeMoCap (TOML): one section a camera, Rodrigues rotation.

``x = K (R X + t)``. FreeMoCap's lengths are millimetres; the unit of the others is that of the board. Caliscope's own
``camera_array.toml`` has a section ``cameras.N`` a camera, the other programs a section at the top.
"""

import math
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np

from pipeline.calibration.contents import CameraFile, in_metres
from pipeline.calibration.readers.rotations import rodrigues_matrix
from pipeline.calibration.validate import MAX_CAMERAS, RawCamera, build_cameras, unknown_fields
from pipeline.errors import InputError, Problem
from pipeline.parsing import ROTATION_VECTOR_RAD, UnreadableError, parse
from pipeline.problem_codes.sessions import CALIBRATION_UNREADABLE, INVALID_ROTATION, UNSUPPORTED_LENS

_KNOWN = frozenset({"name", "size", "matrix", "distortions", "rotation", "translation", "fisheye"})
# Fields of newer FreeMoCap: the same extrinsics once more.
_FREEMOCAP_FIELDS = frozenset({"world_position", "world_orientation"})
_FREEMOCAP_METADATA = frozenset({"charuco_square_size", "groundplane_calibration", "path_to_recorded_videos"})
# FreeMoCap's older default is a board of squares of length 1: lengths are then in squares.
_MIN_SQUARE_MM = 2.0
# Fields of Caliscope's camera_array.toml that are not the calibration.
_CALISCOPE_FIELDS = frozenset({"cam_id", "port", "rotation_count", "error", "exposure", "grid_count", "ignore"})
# Sections that are not cameras.
_IGNORED = frozenset({"metadata"})


def read(content: bytes, file: str) -> CameraFile:
    """Read the cameras of a TOML file; ``InputError`` lists all its problems."""
    try:
        sections = parse(_loads, content)
    except UnreadableError as error:
        message = "The file is not valid TOML, or a number in it is too long."
        raise InputError([Problem(CALIBRATION_UNREADABLE, message, file=file, hint="Export it again.")]) from error
    problems: list[Problem] = []
    arrayed = sections.get("cameras")
    if isinstance(arrayed, dict) and all(isinstance(section, dict) for section in arrayed.values()):
        return _read_caliscope(arrayed, file, problems)
    cameras = ((name, section) for name, section in sections.items() if name not in _IGNORED)
    # One camera above the limit suffices to report that there are too many.
    raw = [_raw(name, section, file, problems) for name, section in islice(cameras, MAX_CAMERAS + 1)]
    built = build_cameras(raw, file, problems)
    return in_metres("FreeMoCap TOML", built, "mm") if _is_freemocap(sections) else CameraFile("TOML", built, None)


def _read_caliscope(sections: Mapping[str, dict[str, Any]], file: str, problems: list[Problem]) -> CameraFile:
    """Read Caliscope's cameras, which it knows by their numbers; cameras without a pose are left out."""
    # Older versions write a missing value as the text "null".
    filled = {
        number: {key: value for key, value in section.items() if key not in _CALISCOPE_FIELDS and value != "null"}
        for number, section in islice(sections.items(), MAX_CAMERAS + 1)
    }
    posed = {
        number: section
        for number, section in filled.items()
        if {"rotation", "translation"} <= section.keys() and sections[number].get("ignore", False) is not True
    }
    left_out = filled.keys() - posed.keys()
    notes = (f"{len(left_out)} cameras of {file} are left out: they are ignored or have no pose.",) if left_out else ()
    # Videos are called cam_0, of older versions port_0.
    raw = [
        replace(_raw(f"cam_{number}", section, file, problems), section=f"port_{number}")
        for number, section in posed.items()
    ]
    return CameraFile("Caliscope", build_cameras(raw, file, problems), None, notes=notes)


def _is_freemocap(sections: Mapping[str, Any]) -> bool:
    """Return whether FreeMoCap wrote the file, with a board whose squares it knows in millimetres."""
    metadata = sections.get("metadata")
    if not isinstance(metadata, dict) or not metadata.keys() & _FREEMOCAP_METADATA:
        return False
    square = metadata.get("charuco_square_size", math.inf)
    return isinstance(square, (int, float)) and square >= _MIN_SQUARE_MM


def _loads(content: bytes) -> dict[str, Any]:
    return tomllib.loads(content.decode("utf-8-sig"))


def _raw(section_name: str, section: Any, file: str, problems: list[Problem]) -> RawCamera:
    if not isinstance(section, dict):
        problems.extend(unknown_fields([section_name], frozenset(), file, None))
        section = {}
    name = section.get("name", section_name)
    problems.extend(unknown_fields(section, _KNOWN | _FREEMOCAP_FIELDS, file, str(name)))
    if not isinstance(section.get("fisheye", False), bool):
        message = "The field fisheye must be true or false."
        problems.append(Problem(UNSUPPORTED_LENS, message, file=file, camera=str(name), field="fisheye"))
    try:
        rotation = rodrigues_matrix(section.get("rotation"))
    except UnreadableError:
        message = f"The rotation must be a Rodrigues vector: 3 numbers from {ROTATION_VECTOR_RAD}."
        problems.append(Problem(INVALID_ROTATION, message, file=file, camera=str(name), field="rotation"))
        rotation = np.eye(3)  # so that the problem is reported only once
    return RawCamera(
        name=name,
        size_px=section.get("size"),
        matrix=section.get("matrix"),
        distortion=section.get("distortions", []),
        rotation=rotation,
        translation_m=section.get("translation"),
        section=section_name,
        lens="fisheye" if section.get("fisheye") is True else "standard",
    )
