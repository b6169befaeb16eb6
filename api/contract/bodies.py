"""Bodies of requests that create sessions and calibrations: forms of files, and JSON that names uploads."""

from collections.abc import Collection, Mapping
from typing import Any

from pydantic import BaseModel

from api.contract import examples
from api.requests.form_kinds import (
    CALIBRATION,
    CALIBRATION_FORM,
    CAPTURE_FORM,
    FORM_TYPE,
    IMAGES,
    INTRINSICS,
    JSON_TYPE,
    KEYPOINTS,
    MANIFEST,
    SESSION_FORM,
    SPEC,
    TIMESTAMPS,
    VIDEOS,
    VIEWS,
    FormKind,
)

SCHEMA_REF = "#/components/schemas/{model}"

_KINDS = (SESSION_FORM, CAPTURE_FORM, CALIBRATION_FORM)
# `format` is OpenAPI 3.0's notation, which generators of clients support; `contentMediaType` is that of 3.1.
_FILE = {"type": "string", "format": "binary", "contentMediaType": "application/octet-stream"}

_OF_SESSION: Mapping[str, str] = {
    VIDEOS: "Videos, one for each camera.",
    KEYPOINTS: "Keypoints in place of videos: for each camera a zip of its keypoint files, named as the camera.",
    CALIBRATION: "Calibration of all cameras; or `calibration_id`.",
    TIMESTAMPS: "Timestamps of keypoints: CSV with the columns camera, frame and time_s.",
}
_OF_CALIBRATION: Mapping[str, str] = {
    CALIBRATION: "Calibration file, for the method `file`.",
    VIDEOS: "Videos of a board or of people.",
    IMAGES: "Photographs of a board in place of videos: for each camera a zip, named as the camera.",
    INTRINSICS: "Calibration file whose intrinsics are kept, and poses ignored.",
}
_ID = {
    "type": "string",
    "format": "uuid",
    "description": "Id of a stored calibration, in place of `calibration`.",
}


def body_of(kind: FormKind, types: Collection[str]) -> dict[str, Any]:
    """Declare the body of an operation, for ``openapi_extra``: a form, JSON that names uploads, or both."""
    of_session = kind is not CALIBRATION_FORM
    spec = examples.DOCUMENTS["spec" if of_session else "calibration_spec"]
    documents = {MANIFEST: examples.DOCUMENTS["manifest"], SPEC: spec}
    said = {part: document for part, document in documents.items() if part in kind.documents}
    calibration = {CALIBRATION: "calibration.toml"} if of_session else {}
    upload = {CALIBRATION: examples.UPLOAD_IDS[2]} if of_session else {}
    content = {
        FORM_TYPE: {
            "schema": {"$ref": SCHEMA_REF.format(model=kind.name)},
            "encoding": {part: {"contentType": JSON_TYPE} for part in said},
            "example": {VIDEOS: ["cam_0.mp4", "cam_1.mp4"], **calibration, **said},
        },
        JSON_TYPE: {
            "schema": {"$ref": SCHEMA_REF.format(model=kind.uploaded.__name__)},
            "example": {VIDEOS: examples.UPLOAD_IDS[:2], **upload, **(said if of_session else spec)},
        },
    }
    return {"requestBody": {"required": True, "content": {name: content[name] for name in content if name in types}}}


def models() -> list[type[BaseModel]]:
    """Models of the JSON in the bodies."""
    found = [model for kind in _KINDS for model in (*kind.documents.values(), kind.uploaded) if model is not None]
    return list(dict.fromkeys(found))


def form_schemas() -> dict[str, Any]:
    """Schemas of the forms, by their names."""
    return {kind.name: _form(kind) for kind in _KINDS}


def _form(kind: FormKind) -> dict[str, Any]:
    described = _OF_CALIBRATION if kind is CALIBRATION_FORM else _OF_SESSION
    properties: dict[str, Any] = {}
    for part in kind.parts:
        schema = {"type": "array", "items": _FILE, "minItems": 1} if part in VIEWS else _FILE
        properties[part] = {**schema, "description": described[part]}
    for part, model in kind.documents.items():
        properties[part] = _ID if model is None else {"$ref": SCHEMA_REF.format(model=model.__name__)}
    return {
        "type": "object",
        "title": kind.name,
        "description": f"Files of a {kind.noun}, with JSON in parts of their own.",
        "properties": properties,
        "additionalProperties": False,
    }
