"""Page ``docs/reference/http-operations.md``: the contract of the HTTP API as tables."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

_CONTRACT = Path(__file__).parents[1] / "openapi" / "openapi.json"
_METHODS = ("get", "post", "put", "patch", "delete")
# Responses of almost every operation; the page of the API describes them once.
_COMMON = {"401", "403", "429", "500", "503"}
_INTRODUCTION = """\
# HTTP operations

This page lists every operation of the HTTP API with its parameters, bodies, responses and schemas. A running service
shows the same at `/docs`, where you can try requests. [HTTP API](http-api.md) explains how they work together.

Errors are [ProblemDetails](#problemdetails) with a [problem code](problems.md). Every operation may also answer 401 (no
valid key), 403, 429 (too many requests), 500 and 503.
"""


def document() -> str:
    """Write the page as Markdown."""
    contract = json.loads(_CONTRACT.read_text(encoding="utf-8"))
    lines = [_INTRODUCTION]
    for tag in contract["tags"]:
        lines += [f"## {tag['name'].capitalize()}", "", tag.get("description", ""), ""]
        for path, item in contract["paths"].items():
            for method in _METHODS:
                if tag["name"] in item.get(method, {}).get("tags", ()):
                    lines += _operation(f"{method.upper()} {path}", item[method], contract)
    lines += ["## Schemas", ""]
    for name, schema in contract["components"]["schemas"].items():
        lines += [f"### {name}", "", _text(schema), "", *_fields(schema)]
    return "\n".join(lines) + "\n"


def _operation(title: str, operation: Mapping[str, Any], contract: Mapping[str, Any]) -> Iterator[str]:
    yield from (f"### {operation['summary']}", "", f"`{title}`", "", _text(operation), "")
    parameters = [_resolved(parameter, contract) for parameter in operation.get("parameters", ())]
    if parameters:
        yield from ("| parameter | in | type | meaning |", "| --- | --- | --- | --- |")
        for parameter in parameters:
            name = f"`{parameter['name']}`" + (" (required)" if parameter.get("required") else "")
            yield f"| {name} | {parameter['in']} | {_type(parameter.get('schema', {}))} | {_text(parameter)} |"
        yield ""
    for media, content in _resolved(operation.get("requestBody", {}), contract).get("content", {}).items():
        yield from (f"Body, `{media}`: {_type(content.get('schema', {}))}", "")
    yield from ("| response | body | meaning |", "| --- | --- | --- |")
    for status, response in operation["responses"].items():
        if status < "400":
            found = _resolved(response, contract)
            bodies = [_type(content.get("schema", {})) for content in found.get("content", {}).values()]
            yield f"| {status} | {', '.join(dict.fromkeys(bodies))} | {_text(found)} |"
    errors = ", ".join(status for status in operation["responses"] if status >= "400" and status not in _COMMON)
    if errors:
        yield from ("", f"Errors: {errors}.")
    yield ""


def _fields(schema: Mapping[str, Any]) -> Iterator[str]:
    if "enum" in schema:
        yield from (", ".join(f"`{value}`" for value in schema["enum"]), "")
    if schema.get("properties"):
        yield from ("| field | type | meaning |", "| --- | --- | --- |")
        for name, value in schema["properties"].items():
            mark = " (required)" if name in schema.get("required", ()) else ""
            yield f"| `{name}`{mark} | {_type(value)} | {_text(value)} |"
        yield ""


def _resolved(value: Mapping[str, Any], contract: Any) -> Mapping[str, Any]:
    """Follow a reference into the contract."""
    if "$ref" not in value:
        return value
    found = contract
    for part in value["$ref"].removeprefix("#/").split("/"):
        found = found[part]
    return dict(found)


def _type(schema: Mapping[str, Any]) -> str:
    match schema:
        case {"$ref": reference}:
            name = reference.rpartition("/")[2]
            text = f"[{name}](#{name.lower()})"
        case {"anyOf": choices} | {"oneOf": choices}:
            text = " or ".join(dict.fromkeys(map(_type, choices)))
        case {"const": value}:
            text = f"`{value}`"
        case {"enum": values}:
            text = ", ".join(f"`{value}`" for value in values)
        case {"type": "array"}:
            text = f"list of {_type(schema.get('items', {}))}"
        case {"type": "object", "additionalProperties": Mapping() as values}:
            text = f"object of {_type(values)}"
        case {"type": "object", "properties": Mapping() as fields}:
            text = "object with " + ", ".join(f"`{name}`" for name in fields)
        case _:
            text = str(schema.get("type", "any"))
    return text


def _text(described: Mapping[str, Any]) -> str:
    return " ".join(str(described.get("description", "")).split()).replace("|", "\\|")
