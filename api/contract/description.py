"""What the routes declare of themselves in OpenAPI: their errors, their forms."""

from collections.abc import Collection, Iterator, Mapping
from typing import Annotated, Any

from fastapi import APIRouter, Body, FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic import BaseModel
from pydantic.json_schema import JsonSchemaMode
from starlette.routing import BaseRoute

from api.contract import examples
from api.errors import ErrorItem, ProblemDetails
from api.http.rates import RATE_HEADERS
from api.requests.form import CALIBRATION, KEYPOINTS, TIMESTAMPS, VIDEOS
from api.schemas import JobEnded, Manifest, UploadedCapture, UploadedSession
from worker.jobs.spec import JobSpec

Responses = dict[int | str, dict[str, Any]]

_SCHEMA_REF = "#/components/schemas/{model}"
_DOCUMENTS: dict[str, type[BaseModel]] = {"manifest": Manifest, "spec": JobSpec}

_ENDED = "Receive a job's end"
_GONE: Responses = {410: {"description": "The receiver is gone: the message is not sent again."}}

_CONVENTIONS = """

- `HEAD` is answered wherever `GET` is: by the same headers, without a body.
- Every POST that makes or changes something takes an `Idempotency-Key`. A repeated request with the same key gets the
  first answer, with `Idempotent-Replayed: true`.
- `ETag` and `If-None-Match` save a client from getting a job or a session again that has not changed (304).
- Where requests a minute are limited, every answer to a key has `RateLimit-Limit`, `RateLimit-Remaining` and
  `RateLimit-Reset` (seconds).
- Errors are `application/problem+json` with a stable `code`; `errors` lists all that is wrong with the request."""
_TAGS = {
    "uploads": "Send large files in pieces, by tus 1.0: after a broken line a client goes on where it was.",
    "sessions": "Capture sessions: the videos or keypoints of all cameras with their calibration.",
    "jobs": "Reconstructions of sessions: start, follow, cancel and retry them.",
    "results": "Files that a job made: BVH and other formats for each person, joints, metrics.",
    "callers": "The key of the caller, and browsers that have shown one.",
    "health": "Whether the service is alive and ready, and its metrics.",
}
_RATE_HEADERS = dict(
    zip(
        RATE_HEADERS,
        (
            {"description": "Requests a minute.", "schema": {"type": "integer"}},
            {"description": "Requests that are left.", "schema": {"type": "integer"}},
            {"description": "Seconds until there are more.", "schema": {"type": "integer"}},
        ),
        strict=True,
    )
)
RETRY_AFTER = {"Retry-After": {"description": "Seconds until it is worth asking.", "schema": {"type": "integer"}}}
_PROBLEM_HEADERS: Mapping[int, Mapping[str, Any]] = {429: RETRY_AFTER | _RATE_HEADERS, 503: RETRY_AFTER}

_MEANINGS = {
    400: "The request can't be read.",
    401: "The service asks for a key, and none that is valid came along.",
    403: "The request comes by a name, from a page, or with a key, that may not do this.",
    404: "There is no such thing.",
    408: "The request comes too slowly.",
    409: "Its state does not allow it.",
    410: "It was there, and was removed.",
    412: "Not the version of the upload protocol that is spoken here.",
    413: "Larger than the service takes.",
    415: "Not a type of content that is taken here.",
    416: "The file has no such range.",
    422: "All that is wrong with the request.",
    423: "Another request writes to it.",
    460: "The piece is not what it was when it was sent.",
    429: "The tenant has as many jobs as it may have, or makes too many requests.",
    500: "The service failed.",
    503: "A part of the service is away.",
    507: "The service's disk is full; of a form nothing was kept.",
}


def answer(example: str) -> dict[str, Any]:
    """Declare an answer's example, one of ``api.contract.examples.ANSWERS``."""
    return {"content": {"application/json": {"examples": {"capture": {"$ref": f"#/components/examples/{example}"}}}}}


def location(what: str, path: str) -> dict[str, Any]:
    """Declare the header that says where something is."""
    example = path.format(**examples.PATH_PARAMETERS)
    return {"description": f"Address of the {what}.", "schema": {"type": "string"}, "example": example}


def problems(*statuses: int) -> Responses:
    """Declare errors."""
    return {status: {"$ref": f"#/components/responses/{_problem_name(status)}"} for status in statuses}


def session_body(*documents: str) -> dict[str, Any]:
    """Declare a form of videos or keypoints, a calibration and some JSON parts, or JSON that names uploads instead."""
    # The way of OpenAPI 3.0, which generators of clients know; 3.1's says the same to others.
    file = {"type": "string", "format": "binary", "contentMediaType": "application/octet-stream"}
    parts = {part: {"$ref": _SCHEMA_REF.format(model=_DOCUMENTS[part].__name__)} for part in documents}
    properties = {
        VIDEOS: {"type": "array", "items": file, "minItems": 1, "description": "One a camera."},
        KEYPOINTS: {
            "type": "array",
            "items": file,
            "minItems": 1,
            "description": "Instead of videos: a zip a camera, named as the camera, of OpenPose's JSON files.",
        },
        CALIBRATION: file | {"description": "Of all cameras."},
        TIMESTAMPS: file | {"description": "Of keypoints: CSV with the columns camera, frame and time_s."},
        **parts,
    }
    return {
        "requestBody": {
            "required": True,
            "content": {
                "multipart/form-data": {
                    "schema": {
                        "type": "object",
                        "properties": properties,
                        "required": [CALIBRATION],
                        "additionalProperties": False,
                    },
                    "encoding": {part: {"contentType": "application/json"} for part in documents},
                    "example": {
                        VIDEOS: ["cam_0.mp4", "cam_1.mp4"],
                        CALIBRATION: "calibration.toml",
                        **{part: examples.DOCUMENTS[part] for part in documents},
                    },
                },
                "application/json": {
                    "schema": {"$ref": _SCHEMA_REF.format(model=_uploaded(documents).__name__)},
                    "example": {
                        VIDEOS: examples.UPLOAD_IDS[:2],
                        CALIBRATION: examples.UPLOAD_IDS[2],
                        **{part: examples.DOCUMENTS[part] for part in documents},
                    },
                },
            },
        }
    }


def _uploaded(documents: Collection[str]) -> type[BaseModel]:
    return UploadedCapture if "spec" in documents else UploadedSession


def _job_ended(
    message: Annotated[JobEnded, Body(openapi_examples={"default": {"value": examples.JOB_ENDED}})],
) -> None:
    """Sent to `callback_url` when the job has ended. Repeated for a day until the receiver answers 2xx or 410."""


def declare_webhooks(app: FastAPI) -> None:
    """Say what the service sends of itself."""
    app.webhooks.post("job-ended", operation_id="jobEnded", summary=_ENDED, status_code=204, responses=_GONE)(
        _job_ended
    )


def job_ended_callbacks(operation_id: str, pointer: str) -> list[BaseRoute]:
    """Declare that an operation leads to a message; ``pointer`` is where its body names the receiver."""
    router = APIRouter()
    address = f"{{$request.body#{pointer}}}"
    router.post(address, operation_id=operation_id, name="jobEnded", summary=_ENDED, status_code=204, responses=_GONE)(
        _job_ended
    )
    return router.routes


def describe(app: FastAPI) -> dict[str, Any]:
    """The app's OpenAPI, with what operations only refer to."""
    if app.openapi_schema is None:
        schema = get_openapi(
            title=app.title,
            version=app.version,
            description=app.description + _CONVENTIONS,
            license_info={"name": "Apache License 2.0", "identifier": "Apache-2.0"},
            servers=[{"url": "/", "description": "Where this document comes from."}],
            tags=[{"name": name, "description": text} for name, text in _TAGS.items()],
            routes=app.routes,
            webhooks=app.webhooks.routes,
        )
        for operation in _operations(schema):
            _finish(operation)
        for name in ("HTTPValidationError", "ValidationError"):
            schema["components"]["schemas"].pop(name, None)
        models = schema["components"]["schemas"]
        sent: list[type[BaseModel]] = [*_DOCUMENTS.values(), UploadedSession, UploadedCapture]
        for model in (ErrorItem, ProblemDetails):
            _describe(models, model, "serialization")
        for part_model in sent:
            _describe(models, part_model, "validation")
        schema["components"] |= {
            "examples": {name: {"value": value} for name, value in examples.ANSWERS.items()},
            "responses": {_problem_name(status): _problem(status) for status in _MEANINGS},
            "schemas": dict(sorted(models.items())),
        }
        _plain_tuples(schema)
        app.openapi_schema = schema
    return app.openapi_schema


def _operations(schema: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """All operations: those of the service, and those that it expects of others."""
    for path in (*schema["paths"].values(), *schema.get("webhooks", {}).values()):
        for operation in path.values():
            yield operation
            for callback in operation.get("callbacks", {}).values():
                yield from _operations({"paths": callback})


def _finish(operation: dict[str, Any]) -> None:
    """Take out the framework's own form of a 422, which no answer has; say where no key is needed."""
    if "content" in operation["responses"].get("422", {}):
        del operation["responses"]["422"]
    operation.setdefault("security", [])
    for answer in operation["responses"].values():
        if "$ref" in answer:  # the framework's description would stand in the way of the problem's own
            answer.pop("description", None)


def _plain_tuples(node: Any) -> None:
    """Describe tuples, whose items are of one kind here, as lists of so many items, which all generators know."""
    if isinstance(node, dict):
        if "prefixItems" in node:
            node["items"], *_ = node.pop("prefixItems")
        for value in node.values():
            _plain_tuples(value)
    elif isinstance(node, list):
        for value in node:
            _plain_tuples(value)


def _describe(models: dict[str, Any], model: type[BaseModel], mode: JsonSchemaMode) -> None:
    """Add a model, and those that it is made of."""
    described = model.model_json_schema(ref_template=_SCHEMA_REF, mode=mode)
    parts = described.pop("$defs", {})
    for name, schema in {**parts, model.__name__: described}.items():
        models.setdefault(name, schema)


def _problem_name(status: int) -> str:
    return f"Problem{status}"


def _problem(status: int) -> dict[str, Any]:
    schema = {"$ref": _SCHEMA_REF.format(model=ProblemDetails.__name__)}
    content = {"application/problem+json": {"schema": schema, "example": examples.problem(status)}}
    headers = {"headers": _PROBLEM_HEADERS[status]} if status in _PROBLEM_HEADERS else {}
    return {"description": _MEANINGS[status], **headers, "content": content}
