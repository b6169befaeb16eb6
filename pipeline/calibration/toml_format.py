"""Caliscope / anipose calibration (TOML): one section a camera, ``x = K (R X + t)``, metres, Rodrigues rotation."""

import tomllib
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.calibration.validate import RawCamera, build_cameras, unknown_fields
from pipeline.data import Camera
from pipeline.errors import InputError, Problem

_KNOWN = frozenset({"name", "size", "matrix", "distortions", "rotation", "translation", "fisheye"})
# Sections that hold no camera.
_IGNORED = frozenset({"metadata"})


def read(content: bytes, file: str) -> tuple[Camera, ...]:
    """Read a TOML file; ``InputError`` with everything that is wrong."""
    try:
        sections = tomllib.loads(content.decode("utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(
            [Problem("calibration_unreadable", "The file is not valid TOML.", file=file, hint="Export it again.")]
        ) from error
    problems: list[Problem] = []
    raw = [_raw(name, section, file, problems) for name, section in sections.items() if name not in _IGNORED]
    return build_cameras(raw, file, problems)


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
    return RawCamera(
        name=name,
        size_px=section.get("size"),
        matrix=section.get("matrix"),
        distortion=section.get("distortions", []),
        rotation=_rotation_matrix(section.get("rotation")),
        translation_m=section.get("translation"),
        section=section_name,
    )


def _rotation_matrix(rodrigues: Any) -> Any:
    """The matrix of a Rodrigues vector; anything else as it is, for the check to complain of."""
    try:
        vector = np.array(rodrigues, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return rodrigues
    if vector.shape != (3,) or not np.isfinite(vector).all():
        return rodrigues
    return Rotation.from_rotvec(vector).as_matrix()
