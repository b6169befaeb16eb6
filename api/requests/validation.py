"""Errors of fields and parameters, translated from Pydantic's errors.

Each wrong field gets one entry with a code of ``api.errors.MEANINGS``, a JSON pointer and a sentence with all allowed
values. The sentence is made from the JSON Schema of the contract, never taken from the library.
"""

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Any, get_args

from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel
from pydantic_core import ErrorDetails
from pydantic_core.core_schema import ErrorType
from starlette.requests import Request
from starlette.responses import Response

from api.errors import ApiError, ErrorItem, pointer_to, problem_response, unprocessable
from worker.requirements import Schema, branches_of, requirement, resolve

UNKNOWN, MISSING, MALFORMED = "unknown_field", "missing_field", "malformed_json"

_CODES: Mapping[str, str] = {
    "extra_forbidden": UNKNOWN,
    "missing": MISSING,
    "json_invalid": MALFORMED,
    "literal_error": "value_not_allowed",
    "enum": "value_not_allowed",
    "greater_than": "out_of_range",
    "greater_than_equal": "out_of_range",
    "less_than": "out_of_range",
    "less_than_equal": "out_of_range",
    "finite_number": "out_of_range",
    "int_parsing_size": "out_of_range",
    "string_too_short": "wrong_length",
    "string_too_long": "wrong_length",
    "too_short": "wrong_length",
    "too_long": "wrong_length",
    "string_pattern_mismatch": "wrong_format",
    "uuid_parsing": "wrong_format",
    "int_from_float": "wrong_type",
    "model_attributes_type": "wrong_type",
}
_LIBRARY_TYPES = frozenset(get_args(ErrorType))

_MAX_SHOWN = 100

_NOUNS: Mapping[str, str] = {"query": "parameter", "path": "parameter", "header": "header", "cookie": "cookie"}

Steps = tuple[str | int, ...]


def model_items(errors: Sequence[ErrorDetails], model: type[BaseModel], part: str = "") -> list[ErrorItem]:
    """Translate Pydantic's errors of a model, which is the body or a part of the form."""
    schema = _schema_of(model)
    return _items(errors, schema, schema, part)


def install(app: FastAPI) -> None:
    """Register the handler that answers wrong bodies and parameters with problems."""
    app.add_exception_handler(RequestValidationError, _handle)


def _handle(request: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)  # noqa: S101 - the framework's signature is wider
    return problem_response(request, _from_validation(request, error))


def _from_validation(request: Request, error: RequestValidationError) -> ApiError:
    details = error.errors()
    if any(detail["type"] == "json_invalid" for detail in details):
        return ApiError("malformed_json", "The body is not JSON.")
    if isinstance(error.body, bytes):  # a body of another type, which the framework does not parse
        message = "This address accepts application/json."
        return ApiError("unsupported_media_type", message, hint="Send Content-Type: application/json.")
    contract = request.app.openapi()
    operation = contract["paths"][request.scope["route"].path][request.scope["method"].lower()]
    in_body = [detail | {"loc": detail["loc"][1:]} for detail in details if detail["loc"][0] == "body"]
    items = _parameter_items([detail for detail in details if detail["loc"][0] != "body"], operation, contract)
    if in_body:
        schema = operation["requestBody"]["content"]["application/json"]["schema"]
        items += _items(in_body, schema, contract, "")
    return unprocessable(items)


def _parameter_items(errors: Iterable[ErrorDetails], operation: Schema, contract: Schema) -> list[ErrorItem]:
    """Translate errors in the query, the path and the headers, one entry for each parameter."""
    parameters = operation.get("parameters", ())
    declared = {(parameter["in"], parameter["name"].lower()): parameter for parameter in parameters}
    items = {}
    for error in errors:
        place, name = (str(step) for step in error["loc"][:2])
        allowed = requirement(declared[place, name.lower()]["schema"], contract, null=False)
        items[place, name] = ErrorItem(
            code=_code(error),
            message=f"The {_NOUNS[place]} {name} must be {allowed}.",
            pointer=pointer_to(place, name),
        )
    return list(items.values())


def _items(errors: Iterable[ErrorDetails], schema: Schema, root: Schema, part: str) -> list[ErrorItem]:
    """Translate errors in JSON, one entry for each field, with pointers below ``part``."""
    by_field: dict[Steps, list[tuple[str, str]]] = {}
    for error in errors:
        steps, code, message = _translated(error, schema, root, part)
        by_field.setdefault(steps, []).append((code, message))
    start = (part,) if part else ()
    items = []
    for steps, translations in by_field.items():
        codes = {code for code, _ in translations}
        if codes == {"value_not_allowed", "wrong_format"}:  # neither a named value nor a name of the user's own
            code = "value_not_allowed"
        else:
            code = codes.pop() if len(codes) == 1 else "invalid_value"
        items.append(ErrorItem(code=code, message=translations[0][1], pointer=pointer_to(*start, *steps)))
    return items


def _translated(error: ErrorDetails, schema: Schema, root: Schema, part: str) -> tuple[Steps, str, str]:
    """Steps to the field, code and sentence of an error."""
    code, where = _code(error), error["loc"]
    if code == UNKNOWN:
        steps, holder = _follow(where[:-1], schema, root)
        known = ", ".join(_properties(holder, root))
        name = _name((*steps, str(where[-1])[:_MAX_SHOWN]), "")
        return (*steps, where[-1]), code, f"There is no field {name} here. The fields are {known}."
    if code == MISSING and where and isinstance(where[-1], int):  # an item of a list with a fixed number of items
        code, where = "wrong_length", where[:-1]
    steps, node = _follow(where, schema, root)
    name = _name(steps, part)
    if error["type"] not in _LIBRARY_TYPES:  # raised by our own validators with a code and a sentence
        return steps, code, error["msg"]
    if code == MALFORMED:
        return steps, code, f"{name} is not JSON."
    if code == MISSING:
        return steps, code, f"{name} is missing. It must be {requirement(node, root)}."
    return steps, code, f"{name} must be {requirement(node, root)}."


def _code(error: ErrorDetails) -> str:
    kind = error["type"]
    if kind not in _LIBRARY_TYPES:
        return kind
    is_type = kind.endswith(("_type", "_parsing"))
    return _CODES.get(kind, "wrong_type" if is_type else "invalid_value")


def _follow(where: Sequence[str | int], schema: Schema, root: Schema) -> tuple[Steps, Schema]:
    """Follow Pydantic's location; omit steps that name branches of a union instead of fields."""
    steps: Steps = ()
    for step in where:
        inner = _inner(schema, step, root)
        if inner is not None:
            steps, schema = (*steps, step), inner
    return steps, schema


def _inner(schema: Schema, step: str | int, root: Schema) -> Schema | None:
    """Schema of a field or an item; ``None`` if the schema has no such field."""
    schema = resolve(schema, root)
    if isinstance(step, int):
        items = schema.get("items") or next(iter(schema.get("prefixItems", ())), None)
        if items is not None:
            return dict(items)
    elif step in schema.get("properties", {}):
        return dict(schema["properties"][step])
    inner = (_inner(branch, step, root) for branch in branches_of(schema))
    return next((schema for schema in inner if schema is not None), None)


def _properties(schema: Schema, root: Schema) -> Iterable[str]:
    schema = resolve(schema, root)
    inner = (name for branch in branches_of(schema) for name in _properties(branch, root))
    return [*schema.get("properties", ()), *inner]


def _name(steps: Steps, part: str) -> str:
    """Name of a field in a sentence.

    >>> _name(("cameras", 1, "offset_s"), "manifest")
    'cameras[1].offset_s'
    """
    if not steps:
        return f"The part {part}" if part else "The body"
    named = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in steps)
    return named.removeprefix(".")


@cache
def _schema_of(model: type[BaseModel]) -> dict[str, Any]:
    return model.model_json_schema()
