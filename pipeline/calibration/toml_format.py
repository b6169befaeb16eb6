"""Caliscope / anipose calibration (TOML): one section a camera, ``x = K (R X + t)``, metres, Rodrigues rotation."""

import tomllib
from itertools import islice
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.calibration.validate import MAX_CAMERAS, RawCamera, build_cameras, unknown_fields
from pipeline.capture.parsing import UnreadableError, parse, read_numbers
from pipeline.capture.quantities import ROTATION_VECTOR_RAD
from pipeline.data import Camera
from pipeline.errors import InputError, Problem

_KNOWN = frozenset({"name", "size", "matrix", "distortions", "rotation", "translation", "fisheye"})
# Sections that are not cameras.
_IGNORED = frozenset({"metadata"})


def read(content: bytes, file: str) -> tuple[Camera, ...]:
    """Read the cameras of a TOML file; ``InputError`` lists all its problems."""
    try:
        sections = parse(_loads, content)
    except UnreadableError as error:
        message = "The file is not valid TOML, or a number in it is too long."
        raise InputError([Problem("calibration_unreadable", message, file=file, hint="Export it again.")]) from error
    problems: list[Problem] = []
    cameras = ((name, section) for name, section in sections.items() if name not in _IGNORED)
    # One camera above the limit suffices to report that there are too many.
    raw = [_raw(name, section, file, problems) for name, section in islice(cameras, MAX_CAMERAS + 1)]
    return build_cameras(raw, file, problems)


def _loads(content: bytes) -> dict[str, Any]:
    return tomllib.loads(content.decode("utf-8-sig"))


def _raw(section_name: str, section: Any, file: str, problems: list[Problem]) -> RawCamera:
    if not isinstance(section, dict):
        problems.extend(unknown_fields([section_name], frozenset(), file, None))
        section = {}
    name = section.get("name", section_name)
    problems.extend(unknown_fields(section, _KNOWN, file, str(name)))
    if section.get("fisheye", False) is not False:
        problems.append(
            Problem(
                "unsupported_lens",
                "Fisheye lenses are not supported.",
                file=file,
                camera=str(name),
                field="fisheye",
                hint="Undistort the videos, or calibrate with the standard model.",
            )
        )
    try:
        rotation = _rotation_matrix(section.get("rotation"))
    except UnreadableError:
        message = f"The rotation must be a Rodrigues vector: 3 numbers from {ROTATION_VECTOR_RAD}."
        problems.append(Problem("invalid_rotation", message, file=file, camera=str(name), field="rotation"))
        rotation = np.eye(3)  # so that the problem is reported only once
    return RawCamera(
        name=name,
        size_px=section.get("size"),
        matrix=section.get("matrix"),
        distortion=section.get("distortions", []),
        rotation=rotation,
        translation_m=section.get("translation"),
        section=section_name,
    )


def _rotation_matrix(rodrigues: Any) -> np.ndarray | None:
    """Matrix of a Rodrigues vector, ``None`` if it is missing; raises ``UnreadableError`` for other values."""
    if rodrigues is None:
        return None
    vector = read_numbers(rodrigues)
    if vector.shape != (3,) or not ROTATION_VECTOR_RAD.holds(vector):
        raise UnreadableError
    return Rotation.from_rotvec(vector).as_matrix()
