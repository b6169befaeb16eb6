"""AsyncAPI document of the WebSocket of live captures: its address, its messages, and their schemas."""

from collections.abc import Iterable
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import JsonSchemaMode

from api.live.examples import MESSAGES
from api.live.schemas import RECEIVED, SENT

_REF = "#/components/schemas/{model}"
_DESCRIPTION = """\
A live capture for as long as the WebSocket is open. The client sends `start`, then keypoints of each camera's frames,
and `end`. The service answers `ready`, then instants with people, and `ended`; a `problem` ends the capture early.
Keypoints and instants may be packed, as messages of bytes. Pages of allowed origins, whose browsers send no headers,
offer the subprotocols `multicap.live` and `mc.key.` with a key behind it. docs/live_service.md describes both forms,
limits and close codes.
"""


def describe_live() -> dict[str, Any]:
    """AsyncAPI 3.0 document."""
    schemas: dict[str, Any] = {}
    messages = {
        **dict(_messages(RECEIVED, "validation", schemas)),
        **dict(_messages(SENT, "serialization", schemas)),
        "PackedKeypoints": _packed("Keypoints of a camera's frame: `MCK1`."),
        "PackedInstant": _packed("People at an instant: `MCI1`."),
    }
    received = [*(model.__name__ for model in RECEIVED), "PackedKeypoints"]
    sent = [*(model.__name__ for model in SENT), "PackedInstant"]
    return {
        "asyncapi": "3.0.0",
        "info": {
            "title": "Multicap live captures",
            "version": "1",
            "description": _DESCRIPTION,
            "license": {"name": "Apache License 2.0"},
        },
        "channels": {
            "live": {
                "address": "/v1/live",
                "messages": {name: {"$ref": f"#/components/messages/{name}"} for name in messages},
                "bindings": {"ws": {"method": "GET"}},
            }
        },
        "operations": {
            "sendToLive": _operation("receive", "Messages of the client.", received),
            "receiveFromLive": _operation("send", "Messages of the service.", sent),
        },
        "components": {
            "messages": messages,
            "schemas": dict(sorted(schemas.items())),
            "securitySchemes": {
                "key": {"type": "http", "scheme": "bearer"},
                "browser": {"type": "httpApiKey", "in": "cookie", "name": "multicap_session"},
            },
        },
    }


def _operation(action: str, summary: str, names: Iterable[str]) -> dict[str, Any]:
    """Operation from the side of the service: it receives or sends."""
    return {
        "action": action,
        "channel": {"$ref": "#/channels/live"},
        "summary": summary,
        "security": [{"$ref": f"#/components/securitySchemes/{name}"} for name in ("key", "browser")],
        "messages": [{"$ref": f"#/channels/live/messages/{name}"} for name in names],
    }


def _messages(
    models: Iterable[type[BaseModel]], mode: JsonSchemaMode, schemas: dict[str, Any]
) -> Iterable[tuple[str, dict[str, Any]]]:
    for model in models:
        schema = model.model_json_schema(ref_template=_REF, mode=mode)
        schemas |= schema.pop("$defs", {})
        schemas[model.__name__] = schema
        yield (
            model.__name__,
            {
                "name": model.model_fields["type"].annotation.__args__[0],  # type: ignore[union-attr]
                "summary": (model.__doc__ or "").partition("\n")[0],
                "contentType": "application/json",
                "payload": {"$ref": _REF.format(model=model.__name__)},
                "examples": [{"payload": MESSAGES[model.__name__]}],
            },
        )


def _packed(summary: str) -> dict[str, Any]:
    return {"summary": summary, "contentType": "application/octet-stream", "payload": {"type": "string"}}
