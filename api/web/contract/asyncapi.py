"""AsyncAPI documents of WebSockets: their addresses, messages and schemas."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import JsonSchemaMode

from api.web.contract.schemas import derive_example

_REF = "#/components/schemas/{model}"
_SCHEMES: Mapping[str, Any] = {
    "key": {"type": "http", "scheme": "bearer"},
    "browser": {"type": "httpApiKey", "in": "cookie", "name": "multicap_session"},
    "link": {"type": "http", "scheme": "bearer", "description": "Secret of a recording's link, `mcl_...`."},
}


@dataclass(frozen=True, slots=True, kw_only=True)
class SocketChannel:
    """Channel of a WebSocket.

    ``received``, ``sent``: models of the messages in JSON that clients send, and that the service sends.
    ``packed_received``, ``packed_sent``: summaries of messages of bytes, by their names. ``security``: names of the
    ways to sign in.
    """

    name: str
    address: str
    received: Sequence[type[BaseModel]]
    sent: Sequence[type[BaseModel]]
    packed_received: Mapping[str, str] = field(default_factory=dict)
    packed_sent: Mapping[str, str] = field(default_factory=dict)
    security: tuple[str, ...] = ("key", "browser")
    parameters: Mapping[str, str] = field(default_factory=dict)  # Descriptions of what the address names


def describe_sockets(title: str, description: str, channels: Sequence[SocketChannel]) -> dict[str, Any]:
    """AsyncAPI 3.0 document."""
    schemas: dict[str, Any] = {}
    messages: dict[str, Any] = {}
    for channel in channels:
        messages |= _messages(channel.received, "validation", schemas)
        messages |= _messages(channel.sent, "serialization", schemas)
        packed = {**channel.packed_received, **channel.packed_sent}
        messages |= {name: _packed(summary) for name, summary in packed.items()}
    used = {name for channel in channels for name in channel.security}
    return {
        "asyncapi": "3.0.0",
        "info": {"title": title, "version": "1", "description": description, "license": {"name": "Apache License 2.0"}},
        "channels": {channel.name: _channel(channel) for channel in channels},
        "operations": {name: operation for channel in channels for name, operation in _operations(channel).items()},
        "components": {
            "messages": messages,
            "schemas": dict(sorted(schemas.items())),
            "securitySchemes": {name: _SCHEMES[name] for name in _SCHEMES if name in used},
        },
    }


def _names(models: Iterable[type[BaseModel]], packed: Iterable[str]) -> list[str]:
    return [*(model.__name__ for model in models), *packed]


def _channel(channel: SocketChannel) -> dict[str, Any]:
    models = dict.fromkeys([*_names(channel.received, ()), *_names(channel.sent, ())])
    names = [*models, *channel.packed_received, *channel.packed_sent]
    parameters = {name: {"description": text} for name, text in channel.parameters.items()}
    return {
        "address": channel.address,
        "messages": {name: {"$ref": f"#/components/messages/{name}"} for name in names},
        **({"parameters": parameters} if parameters else {}),
        "bindings": {"ws": {"method": "GET"}},
    }


def _operations(channel: SocketChannel) -> dict[str, Any]:
    """Operations from the side of the service: it receives or sends."""
    name = channel.name[0].upper() + channel.name[1:]
    received = _names(channel.received, channel.packed_received)
    sent = _names(channel.sent, channel.packed_sent)
    return {
        f"sendTo{name}": _operation("receive", "Messages of the client.", channel, received),
        f"receiveFrom{name}": _operation("send", "Messages of the service.", channel, sent),
    }


def _operation(action: str, summary: str, channel: SocketChannel, names: Iterable[str]) -> dict[str, Any]:
    return {
        "action": action,
        "channel": {"$ref": f"#/channels/{channel.name}"},
        "summary": summary,
        "security": [{"$ref": f"#/components/securitySchemes/{name}"} for name in channel.security],
        "messages": [{"$ref": f"#/channels/{channel.name}/messages/{name}"} for name in names],
    }


def _messages(models: Iterable[type[BaseModel]], mode: JsonSchemaMode, schemas: dict[str, Any]) -> dict[str, Any]:
    """Messages of models; their schemas go to ``schemas``."""
    messages: dict[str, Any] = {}
    for model in models:
        schema = model.model_json_schema(ref_template=_REF, mode=mode)
        schemas |= schema.pop("$defs", {})
        schemas[model.__name__] = schema
        messages[model.__name__] = {
            "name": model.model_fields["type"].annotation.__args__[0],  # type: ignore[union-attr]
            "summary": (model.__doc__ or "").partition("\n")[0],
            "contentType": "application/json",
            "payload": {"$ref": _REF.format(model=model.__name__)},
            "examples": [{"payload": derive_example(schema, schemas)}],
        }
    return messages


def _packed(summary: str) -> dict[str, Any]:
    return {"summary": summary, "contentType": "application/octet-stream", "payload": {"type": "string"}}
