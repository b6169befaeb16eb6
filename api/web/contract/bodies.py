"""Bodies of requests that create records, as OpenAPI: forms of files, and JSON that names uploads."""

from collections.abc import Collection
from typing import Any

from api.web.http.bodies.form_kinds import FORM_TYPE, JSON_TYPE, VIEWS, FormKind

SCHEMA_REF = "#/components/schemas/{model}"

# `format` is OpenAPI 3.0's notation, which generators of clients support; `contentMediaType` is that of 3.1.
_FILE = {"type": "string", "format": "binary", "contentMediaType": "application/octet-stream"}
_ID = {
    "type": "string",
    "format": "uuid",
    "description": "Id of a stored calibration, in place of `calibration`.",
}


def body_of(kind: FormKind, types: Collection[str]) -> dict[str, Any]:
    """Declare the body of an operation, for ``openapi_extra``: a form, JSON that names uploads, or both."""
    content = {
        FORM_TYPE: {
            "schema": {"$ref": SCHEMA_REF.format(model=kind.name)},
            "encoding": {part: {"contentType": JSON_TYPE} for part in kind.models},
            "example": kind.form_example,
        },
        JSON_TYPE: {
            "schema": {"$ref": SCHEMA_REF.format(model=kind.uploaded.__name__)},
            "example": kind.uploaded_example,
        },
    }
    return {"requestBody": {"required": True, "content": {name: content[name] for name in content if name in types}}}


def form_schema(kind: FormKind) -> dict[str, Any]:
    """Schema of a form."""
    properties: dict[str, Any] = {}
    for part, description in kind.parts.items():
        schema = {"type": "array", "items": _FILE, "minItems": 1} if part in VIEWS else _FILE
        properties[part] = {**schema, "description": description}
    for part, model in kind.documents.items():
        properties[part] = _ID if model is None else {"$ref": SCHEMA_REF.format(model=model.__name__)}
    return {
        "type": "object",
        "title": kind.name,
        "description": f"Files of a {kind.noun}, with JSON in parts of their own.",
        "properties": properties,
        "additionalProperties": False,
    }
