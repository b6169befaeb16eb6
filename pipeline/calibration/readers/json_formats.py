"""Calibration in JSON: Multicap's own format, and formats of other programs and data sets.

Rows of the table of formats:

| Multicap | `.json` with `schema_version` | m | Z up |
"""

from collections.abc import Mapping
from typing import Any, get_args

from pipeline.calibration.advice import other_keys
from pipeline.calibration.contents import UNKNOWN_SIZE, CameraFile
from pipeline.calibration.formats import reader
from pipeline.calibration.readers import json_datasets, opencv
from pipeline.calibration.readers.file_storage import with_matrices
from pipeline.calibration.reading import Reading
from pipeline.calibration.validate import MAX_CAMERAS, RawCamera
from pipeline.core.data.cameras import LensModel
from pipeline.core.errors import InputError, Problem
from pipeline.core.parsing import UnreadableError, read_unique_json
from pipeline.core.problems.session_codes import CALIBRATION_UNREADABLE, UNKNOWN_VERSION, UNSUPPORTED_LENS

SCHEMA_VERSION = 1

_OWN = frozenset({"name", "size_px", "matrix", "distortion", "rotation", "translation_m", "lens"})
_LENSES = get_args(LensModel)


@reader("JSON", suffixes=(".json",), starts=(b"{",))
def read(content: bytes, file: str) -> CameraFile:
    """Read the cameras of a JSON file; ``InputError`` lists all its problems."""
    try:
        document = read_unique_json(content)
        contents = _read_other({"cameras": document} if isinstance(document, list) else document, file)
    except UnreadableError as error:
        message = "The file is not valid JSON, or repeats a key."
        raise InputError([Problem(CALIBRATION_UNREADABLE, message, file=file, hint="Export it again.")]) from error
    if contents is not None:
        return contents
    listed = document.get("cameras") if isinstance(document, dict) else None
    if not isinstance(listed, list) or not all(isinstance(camera, dict) for camera in listed):
        message, hint = other_keys(document if isinstance(document, dict) else ())
        raise InputError([Problem(CALIBRATION_UNREADABLE, message, file=file, field="cameras", hint=hint)])
    return _read_own(document, listed, file)


def _read_other(document: Any, file: str) -> CameraFile | None:
    """Read the formats of other programs, ``None`` for files that are not theirs."""
    if not isinstance(document, dict) or "schema_version" in document:
        return None
    listed = document.get("cameras")
    if isinstance(listed, list) and any(map(_is_own, listed)):
        return None
    contents = json_datasets.read_document(document, file)
    return opencv.read_fields(with_matrices(document), file) if contents is None else contents


def _is_own(camera: Any) -> bool:
    return isinstance(camera, dict) and "translation_m" in camera


def _read_own(document: Mapping[str, Any], listed: list[dict[str, Any]], file: str) -> CameraFile:
    reading = Reading(file)
    reading.pass_over(document, frozenset({"cameras", "schema_version"}))
    if document.get("schema_version") != SCHEMA_VERSION:
        reading.complain(UNKNOWN_VERSION, f"schema_version must be {SCHEMA_VERSION}.", field="schema_version")
    # One camera above the limit suffices to report that there are too many.
    listed = listed[: MAX_CAMERAS + 1]
    raw = [_raw(camera) for camera in listed]
    for camera, raw_camera in zip(listed, raw, strict=True):
        reading.pass_over(camera, _OWN, raw_camera)
        if camera.get("lens", "standard") not in _LENSES:
            message = f"The lens must be one of {', '.join(_LENSES)}."
            reading.complain(UNSUPPORTED_LENS, message, str(camera.get("name")), "lens")
    return reading.contents("Multicap JSON", raw, "m")


def _raw(camera: Mapping[str, Any]) -> RawCamera:
    return RawCamera(
        name=camera.get("name"),
        size_px=UNKNOWN_SIZE if camera.get("size_px", ...) is None else camera.get("size_px"),
        matrix=camera.get("matrix"),
        distortion=camera.get("distortion"),
        rotation=camera.get("rotation"),
        translation_m=camera.get("translation_m"),
        lens="fisheye" if camera.get("lens") == "fisheye" else "standard",
    )
