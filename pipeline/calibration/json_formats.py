"""Calibration in JSON: Multicap's own format, and that of benchmark conversions (``K``, ``R``, ``t``, ``dist``)."""

from collections.abc import Mapping
from typing import Any

from pipeline.calibration.validate import MAX_CAMERAS, RawCamera, build_cameras, unknown_fields
from pipeline.capture.parsing import UnreadableError, read_json
from pipeline.data import Camera
from pipeline.errors import InputError, Problem

SCHEMA_VERSION = 1

_OWN = frozenset({"name", "size_px", "matrix", "distortion", "rotation", "translation_m"})
_SHORT = frozenset({"name", "width", "height", "K", "R", "t", "dist"})


def read(content: bytes, file: str) -> tuple[Camera, ...]:
    """Read the cameras of a JSON file; ``InputError`` lists all its problems."""
    try:
        document = read_json(content)
    except UnreadableError as error:
        raise InputError(
            [Problem("calibration_unreadable", "The file is not valid JSON.", file=file, hint="Export it again.")]
        ) from error
    listed = document.get("cameras") if isinstance(document, dict) else None
    if not isinstance(listed, list) or not all(isinstance(camera, dict) for camera in listed):
        raise InputError(
            [Problem("calibration_unreadable", "The file has no list of cameras.", file=file, field="cameras")]
        )
    # One camera above the limit suffices to report that there are too many.
    listed = listed[: MAX_CAMERAS + 1]
    short = bool(listed) and all("K" in camera for camera in listed)
    problems = unknown_fields(document, frozenset({"cameras", "convention" if short else "schema_version"}), file, None)
    if not short and document.get("schema_version") != SCHEMA_VERSION:
        problems.append(
            Problem("unknown_version", f"schema_version must be {SCHEMA_VERSION}.", file=file, field="schema_version")
        )
    known, raw = (_SHORT, _raw_short) if short else (_OWN, _raw_own)
    for camera in listed:
        problems.extend(unknown_fields(camera, known, file, str(camera.get("name"))))
    return build_cameras([raw(camera) for camera in listed], file, problems)


def _raw_own(camera: Mapping[str, Any]) -> RawCamera:
    return RawCamera(
        name=camera.get("name"),
        size_px=camera.get("size_px"),
        matrix=camera.get("matrix"),
        distortion=camera.get("distortion"),
        rotation=camera.get("rotation"),
        translation_m=camera.get("translation_m"),
    )


def _raw_short(camera: Mapping[str, Any]) -> RawCamera:
    return RawCamera(
        name=camera.get("name"),
        size_px=[camera["width"], camera["height"]] if {"width", "height"} <= camera.keys() else None,
        matrix=camera.get("K"),
        distortion=camera.get("dist", []),
        rotation=camera.get("R"),
        translation_m=camera.get("t"),
    )
