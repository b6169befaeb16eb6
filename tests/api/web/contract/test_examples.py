"""Examples of bodies are derived from schemas."""

from typing import Any

import pytest

from api.web.contract.schemas import ID, derive_example

MODELS = {"Camera": {"type": "object", "properties": {"name": {"type": "string", "examples": ["left"]}}}}


@pytest.mark.parametrize(
    ("schema", "example"),
    [
        ({"type": "string", "format": "uuid"}, ID),
        ({"type": "integer", "default": 7, "examples": [3, 4]}, 3),
        ({"type": "integer", "default": 7}, 7),
        ({"enum": ["tracking", "clustering"]}, "tracking"),
        ({"anyOf": [{"type": "integer"}, {"type": "null"}]}, None),
        ({"oneOf": [{"const": "a"}, {"const": "b"}]}, "a"),
        ({"type": "number", "minimum": 16}, 16),
        ({"type": "number", "minimum": -1e12}, 1),
        ({"type": "array", "items": {"type": "boolean"}}, [False]),
        ({"type": "array", "items": {"type": "integer"}, "minItems": 2}, [1, 1]),
        ({"type": "array", "prefixItems": [{"type": "boolean"}, {"const": "b"}]}, [False, "b"]),
        ({"$ref": "#/components/schemas/Camera"}, {"name": "left"}),
        ({"type": "object", "additionalProperties": True}, {}),
        (
            {
                "type": "object",
                "properties": {"rate": {"type": "integer"}, "note": {"type": "string"}, "up": {"examples": ["z"]}},
                "required": ["rate"],
            },
            {"rate": 1, "up": "z"},
        ),
    ],
)
def test_example_follows_from_schema(schema: dict[str, Any], example: object) -> None:
    assert derive_example(schema, MODELS) == example
