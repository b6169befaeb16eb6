"""OpenAPI document of the web API: resources, bodies and responses as their routes declare them."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from fastapi import APIRouter, FastAPI
from fastapi.openapi.utils import get_openapi
from fastapi.routing import APIRoute
from pydantic import BaseModel
from pydantic.json_schema import JsonSchemaMode

from api.web.contract.schemas import ID, derive_example
from api.web.errors import ErrorItem, ProblemDetails, status_title
from api.web.http.bodies.form_kinds import FORM_TYPE, JSON_TYPE, VIEWS, FormKind
from api.web.http.rates import RATE_HEADERS
from pipeline.core.problems.request_codes import ANSWERS


@dataclass(frozen=True, slots=True, kw_only=True)
class Resource:
    """A resource, or a part of it; ``api.web.resources`` registers each.

    ``router``: routes of the resource. ``is_open``: whether its routes need no key. ``forms``: kinds of the forms that
    its routes take.
    """

    router: APIRouter
    is_open: bool = False
    forms: tuple[FormKind, ...] = ()


SCHEMA_REF = "#/components/schemas/{model}"

# `format` is OpenAPI 3.0's notation, which generators of clients support; `contentMediaType` is 3.1's.
_FILE = {"type": "string", "format": "binary", "contentMediaType": "application/octet-stream"}
_ID = {
    "type": "string",
    "format": "uuid",
    "examples": [ID],
    "description": "Id of a stored calibration, in place of `calibration`.",
}


def request_body(kind: FormKind, types: Collection[str]) -> dict[str, Any]:
    """Declare the body of an operation, for ``openapi_extra``: a form, JSON that names uploads, or both."""
    content = {
        FORM_TYPE: {
            "schema": {"$ref": SCHEMA_REF.format(model=kind.name)},
            "encoding": {part: {"contentType": JSON_TYPE} for part in kind.models},
        },
        JSON_TYPE: {"schema": {"$ref": SCHEMA_REF.format(model=kind.uploaded.__name__)}},
    }
    return {"requestBody": {"required": True, "content": {name: content[name] for name in content if name in types}}}


def form_schema(kind: FormKind) -> dict[str, Any]:
    """Schema of a form."""
    properties: dict[str, Any] = {}
    for part, description in kind.parts.items():
        schema = {"type": "array", "items": _FILE, "minItems": 1} if part in VIEWS else _FILE
        properties[part] = {**schema, "description": description}
    first = next(iter(properties))
    properties[first]["examples"] = [derive_example(properties[first], {})]
    for part, model in kind.documents.items():
        properties[part] = _ID if model is None else {"$ref": SCHEMA_REF.format(model=model.__name__)}
    return {
        "type": "object",
        "title": kind.name,
        "description": f"Files of a {kind.noun}, with JSON in parts of their own.",
        "properties": properties,
        "additionalProperties": False,
    }


Responses = dict[int | str, dict[str, Any]]

_CONVENTIONS = """

- `HEAD` is answered wherever `GET` is, with the same headers and without a body.
- Every POST that creates or changes something takes an `Idempotency-Key`. A repeated request with the same key gets the
  first response, with `Idempotent-Replayed: true`.
- With `ETag` and `If-None-Match` a client gets a job or a session only if it has changed; else the response is 304.
- If requests a minute are limited, every response to a request with a key has `RateLimit-Limit`, `RateLimit-Remaining`
  and `RateLimit-Reset` (seconds).
- Errors are `application/problem+json` with a stable `code`; `errors` lists all problems of the request."""
_TAGS = {
    "uploads": "Large files in pieces, by tus 1.0. After an interrupted connection a client continues at the offset.",
    "calibrations": "Calibrations of cameras: sent as files, or made from a board.",
    "characters": "Characters of the user's own, onto which motion is retargeted.",
    "sessions": "Capture sessions: the videos or keypoints of all cameras with their calibration.",
    "jobs": "Reconstructions of sessions: start, follow, cancel and retry them.",
    "results": "Result files of a job: BVH and other formats for each person, joints, metrics.",
    "links": "Links that open a job, or something of it, without a key, for a while.",
    "recordings": "Recordings by phones: rooms in which browsers record takes, and sessions and calibrations of them.",
    "live": "Cameras of the service's machine, for live captures; `/live.asyncapi.json` describes `WS /v1/live`.",
    "callers": "Caller of a request, and signing browsers in and out.",
    "health": "Liveness, readiness and metrics of the service.",
}
_RATE_HEADERS = dict(
    zip(
        RATE_HEADERS,
        (
            {"description": "Allowed requests a minute.", "schema": {"type": "integer"}},
            {"description": "Requests left.", "schema": {"type": "integer"}},
            {"description": "Seconds until the limit resets.", "schema": {"type": "integer"}},
        ),
        strict=True,
    )
)
RETRY_AFTER = {
    "Retry-After": {"description": "Seconds to wait before the next request.", "schema": {"type": "integer"}}
}
_PROBLEM_HEADERS: Mapping[int, Mapping[str, Any]] = {429: RETRY_AFTER | _RATE_HEADERS, 503: RETRY_AFTER}

_MEANINGS = {
    400: "The request can't be read.",
    401: "The request has no valid key.",
    403: "The request's host, origin or key does not allow this.",
    404: "There is no such session, job, upload, character, result or address.",
    408: "The request arrives too slowly.",
    409: "The state of the job, session or upload does not allow this.",
    410: "The file was removed.",
    412: "The record has changed since the client's version, or the upload protocol has another version.",
    413: "The request is larger than the service accepts.",
    415: "The address does not accept the content type.",
    416: "The file has no such range.",
    422: "Fields, parts or files of the request are wrong; `errors` lists all of them.",
    421: "The bytes of the upload are at another API process.",
    423: "Another request is writing to the upload.",
    460: "The piece that arrived does not have the checksum that was sent.",
    429: "The tenant has too many unfinished jobs, or makes too many requests.",
    500: "The service failed.",
    503: "A part of the service does not respond.",
    507: "The service's disk is full; nothing of a form was kept.",
}
_RETRYABLE = {408, 423, 429, 460, 500, 503, 507}


def file_content(media_types: Iterable[str]) -> dict[str, Any]:
    """Declare the content of a response that is a file of one of some media types, whose bytes clients keep.

    A file of JSON has no `type`: it is no text in JSON, though clients keep it as it is.
    """
    binary = {"format": "binary", "contentMediaType": "application/octet-stream"}
    return {
        name: {
            "schema": binary if name == "application/json" else {"type": "string", **binary},
            "example": "(the file)",
        }
        for name in media_types
    }


def location(what: str) -> dict[str, Any]:
    """Declare the header ``Location`` of a record."""
    return {"description": f"Address of the {what}.", "schema": {"type": "string"}, "example": f"/v1/{what}s/{ID}"}


def problems(*statuses: int) -> Responses:
    """Declare error responses by their statuses."""
    return {status: {"$ref": f"#/components/responses/{_problem_name(status)}"} for status in statuses}


def operation_id(route: APIRoute) -> str:
    """Id of an operation: the name of its function in camel case."""
    first, *others = route.name.split("_")
    return first + "".join(map(str.capitalize, others))


def describe(app: FastAPI, resources: Iterable[Resource]) -> dict[str, Any]:
    """OpenAPI document of the app, with the shared responses, examples and schemas."""
    if app.openapi_schema is None:
        schema = get_openapi(
            title=app.title,
            version=app.version,
            description=app.description + _CONVENTIONS,
            license_info={"name": "Apache License 2.0", "identifier": "Apache-2.0"},
            servers=[{"url": "/", "description": "Service that serves this document."}],
            tags=[{"name": name, "description": text} for name, text in _TAGS.items()],
            routes=app.routes,
            webhooks=app.webhooks.routes,
        )
        for operation in _operations(schema):
            _finish(operation)
        for name in ("HTTPValidationError", "ValidationError"):
            schema["components"]["schemas"].pop(name, None)
        models = schema["components"]["schemas"]
        for model in (ErrorItem, ProblemDetails):
            _describe(models, model, "serialization")
        for form in (form for resource in resources for form in resource.forms):
            for part_model in (*form.models.values(), form.uploaded):
                _describe(models, part_model, "validation")
            models[form.name] = form_schema(form)
        schema["components"] |= {
            "examples": dict(sorted(_add_examples(schema).items())),
            "responses": {_problem_name(status): _problem(status, models) for status in _MEANINGS},
            "schemas": dict(sorted(models.items())),
        }
        _plain_tuples(schema)
        app.openapi_schema = schema
    return app.openapi_schema


def _operations(schema: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """All operations of the service, and all webhooks that receivers implement."""
    for path in (*schema["paths"].values(), *schema.get("webhooks", {}).values()):
        for operation in path.values():
            yield operation
            for callback in operation.get("callbacks", {}).values():
                yield from _operations({"paths": callback})


def _add_examples(schema: Mapping[str, Any]) -> dict[str, Any]:
    """Refer from all bodies to examples of their models; return these by the names of the models."""
    models, examples = schema["components"]["schemas"], {}
    for operation in _operations(schema):
        for body in (operation.get("requestBody", {}), *operation["responses"].values()):
            for content in body.get("content", {}).values():
                if "$ref" in content["schema"]:
                    name = content["schema"]["$ref"].rpartition("/")[2]
                    examples[name] = {"value": derive_example(content["schema"], models)}
                    content["examples"] = {"derived": {"$ref": f"#/components/examples/{name}"}}
    return examples


def _finish(operation: dict[str, Any]) -> None:
    """Remove the framework's own 422, which is never sent; declare operations without a key."""
    if "content" in operation["responses"].get("422", {}):
        del operation["responses"]["422"]
    operation.setdefault("security", [])
    for answer in operation["responses"].values():
        if "$ref" in answer:  # the framework's description would override the shared response's
            answer.pop("description", None)


def _plain_tuples(node: Any) -> None:
    """Describe tuples as lists with a fixed number of items: all generators of clients support these.

    The items of every tuple in the contract have the same type.
    """
    if isinstance(node, dict):
        if "prefixItems" in node:
            node["items"], *_ = node.pop("prefixItems")
        for value in node.values():
            _plain_tuples(value)
    elif isinstance(node, list):
        for value in node:
            _plain_tuples(value)


def _describe(models: dict[str, Any], model: type[BaseModel], mode: JsonSchemaMode) -> None:
    """Add the schema of a model, and the schemas that it contains."""
    described = model.model_json_schema(ref_template=SCHEMA_REF, mode=mode)
    parts = described.pop("$defs", {})
    for name, schema in {**parts, model.__name__: described}.items():
        models.setdefault(name, schema)


def _problem_name(status: int) -> str:
    return f"Problem{status}"


def _problem(status: int, models: Mapping[str, Any]) -> dict[str, Any]:
    schema = {"$ref": SCHEMA_REF.format(model=ProblemDetails.__name__)}
    example = derive_example(schema, models) | {
        "title": status_title(status),
        "status": status,
        "detail": _MEANINGS[status],
        "code": next(code for code, places in ANSWERS.places.items() if status in places),
        "errors": [derive_example(models[ErrorItem.__name__], models)] if status == 422 else [],
        "retryable": status in _RETRYABLE,
    }
    content = {"application/problem+json": {"schema": schema, "example": example}}
    headers = {"headers": _PROBLEM_HEADERS[status]} if status in _PROBLEM_HEADERS else {}
    return {"description": _MEANINGS[status], **headers, "content": content}
