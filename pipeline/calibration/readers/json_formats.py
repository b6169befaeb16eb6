"""Calibration in JSON: Multicap's own format, benchmark conversions (``K``, ``R``, ``t``, ``dist``), other programs."""

from collections.abc import Mapping
from typing import Any, get_args

from pipeline.calibration.contents import UNKNOWN_SIZE, CameraFile
from pipeline.calibration.readers import json_datasets, opencv
from pipeline.calibration.readers.file_storage import with_matrices
from pipeline.calibration.reading import Reading
from pipeline.calibration.validate import MAX_CAMERAS, RawCamera
from pipeline.data.cameras import LensModel
from pipeline.errors import InputError, Problem
from pipeline.parsing import UnreadableError, read_unique_json
from pipeline.problem_codes.sessions import CALIBRATION_UNREADABLE, UNKNOWN_VERSION, UNSUPPORTED_LENS

SCHEMA_VERSION = 1

_OWN = frozenset({"name", "size_px", "matrix", "distortion", "rotation", "translation_m", "lens"})
_LENSES = get_args(LensModel)
_SHORT = frozenset({"name", "width", "height", "K", "R", "t", "dist"})


def read(content: bytes, file: str) -> CameraFile:
    """Read the cameras of a JSON file; ``InputError`` lists all its problems."""
    try:
        document = read_unique_json(content)
        contents = _read_other(document, file) if isinstance(document, dict) else None
    except UnreadableError as error:
        raise InputError(
            [
                Problem(
                    CALIBRATION_UNREADABLE,
                    "The file is not valid JSON, or repeats a key.",
                    file=file,
                    hint="Export it again.",
                )
            ]
        ) from error
    if contents is not None:
        return contents
    listed = document.get("cameras") if isinstance(document, dict) else None
    if not isinstance(listed, list) or not all(isinstance(camera, dict) for camera in listed):
        raise InputError(
            [Problem(CALIBRATION_UNREADABLE, "The file has no list of cameras.", file=file, field="cameras")]
        )
    # One camera above the limit suffices to report that there are too many.
    listed = listed[: MAX_CAMERAS + 1]
    short = bool(listed) and all("K" in camera for camera in listed)
    reading = Reading(file)
    reading.pass_over(document, frozenset({"cameras", "convention" if short else "schema_version"}))
    if not short and document.get("schema_version") != SCHEMA_VERSION:
        reading.complain(UNKNOWN_VERSION, f"schema_version must be {SCHEMA_VERSION}.", field="schema_version")
    known, raw = (_SHORT, _raw_short) if short else (_OWN, _raw_own)
    for camera in listed:
        reading.pass_over(camera, known)
        if not short and camera.get("lens", "standard") not in _LENSES:
            message = f"The lens must be one of {', '.join(_LENSES)}."
            reading.complain(UNSUPPORTED_LENS, message, str(camera.get("name")), "lens")
    cameras = [raw(camera) for camera in listed]
    return reading.contents(*(("JSON with K, R and t", cameras, None) if short else ("Multicap JSON", cameras, "m")))


def _read_other(document: dict[str, Any], file: str) -> CameraFile | None:
    """Read the formats of other programs, ``None`` for files that are not theirs."""
    listed = document.get("cameras")
    if "schema_version" in document or (isinstance(listed, list) and not json_datasets.is_panoptic(listed)):
        return None
    contents = json_datasets.read_document(document, file)
    return opencv.read_fields(with_matrices(document), file) if contents is None else contents


def _raw_own(camera: Mapping[str, Any]) -> RawCamera:
    return RawCamera(
        name=camera.get("name"),
        size_px=UNKNOWN_SIZE if camera.get("size_px", ...) is None else camera.get("size_px"),
        matrix=camera.get("matrix"),
        distortion=camera.get("distortion"),
        rotation=camera.get("rotation"),
        translation_m=camera.get("translation_m"),
        lens="fisheye" if camera.get("lens") == "fisheye" else "standard",
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
