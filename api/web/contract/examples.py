"""Examples of bodies and messages, derived from their schemas and from the examples of single fields."""

from collections.abc import Mapping
from typing import Any

ID = "01890a5e-1f3b-7d52-9c41-5a6f0b1c2d3e"
UPLOAD_IDS = [f"01890a5c-7c1e-7a4b-8f00-00000000000{index}" for index in range(2)]
TIME = "2026-03-01T09:30:00Z"
SHA256 = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"

WARNING = "cam_0.mp4: 1 frame is left out, because another frame has the same timestamp."

_TEXTS = {"uuid": ID, "date-time": TIME, "binary": "(the file)"}


def derive_example(schema: Mapping[str, Any], models: Mapping[str, Any]) -> Any:
    """Derive an example from a JSON schema.

    An example of the schema goes before its default, and null before other types. Objects have their required fields,
    and optional fields that have an example.

    ``models``: schemas that references name.
    """
    match schema:
        case {"examples": [given, *_]} | {"default": given} | {"const": given} | {"enum": [given, *_]}:
            example = given
        case {"$ref": str(reference)}:
            example = derive_example(models[reference.rpartition("/")[2]], models)
        case {"anyOf": [first, *others]} | {"oneOf": [first, *others]}:
            example = None if {"type": "null"} in others else derive_example(first, models)
        case {"type": "object"}:
            required, fields = schema.get("required", ()), schema.get("properties", {}).items()
            shown = {name: field for name, field in fields if name in required or "examples" in field}
            example = {name: derive_example(field, models) for name, field in shown.items()}
        case {"prefixItems": [*items]}:
            example = [derive_example(item, models) for item in items]
        case {"type": "array"}:
            example = [derive_example(schema["items"], models)] * schema.get("minItems", 1)
        case {"type": "string"}:
            example = _TEXTS.get(schema.get("format", ""), "...")
        case {"type": "boolean"}:
            example = False
        case _:
            example = max(1, schema.get("minimum", 1))
    return example
