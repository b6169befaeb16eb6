"""Errors of fields and parameters, translated from Pydantic's errors, and fields that were sent elsewhere.

Each wrong field gets one entry with a code of ``api.web.errors.MEANINGS``, a JSON pointer and a sentence with all
allowed values. The sentence is made from the JSON Schema of the contract, never taken from the library. A body may have
as many wrong fields as it has room for: of those that no answer lists, only the number is found out.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache, cached_property
from itertools import islice
from typing import Any, Self, get_args

from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails
from pydantic_core.core_schema import ErrorType
from starlette.requests import Request
from starlette.responses import Response

from api.web.errors import MAX_LISTED, ApiError, ErrorItem, more_problems, pointer_to, problem_response, unprocessable
from pipeline.core.options.requirements import Schema, Steps, path_text, requirement, resolve, schema_branches
from pipeline.core.problems import request_codes
from pipeline.core.problems.code_group import Code

_ITEM = "[]"


class FieldPlaces:
    """Places at which the body of a request has fields, by their names; read when a hint is asked for.

    ``declared``: gives the schema of the body, and the document that contains the targets of its references.
    """

    def __init__(self, declared: Callable[[], tuple[Schema, Schema]]) -> None:
        self._declared = declared

    @classmethod
    def declared_for(cls, request: Request, content_type: str) -> Self:
        """Places in the body that the contract declares for a request of a content type."""

        def declared() -> tuple[Schema, Schema]:
            contract = request.app.openapi()
            operation = contract["paths"][request.scope["route"].path][request.scope["method"].lower()]
            return operation["requestBody"]["content"][content_type]["schema"], contract

        return cls(declared)

    def hint(self, name: str, sent_in: str) -> str | None:
        """Say where a field belongs that was sent in an object without such a field.

        ``sent_in``: path of the object, such as ``manifest.cameras[]``; empty for the body itself. Returns a sentence;
        ``None`` if the body has no such field, or has it in the same objects.

        >>> properties = {"spec": {"properties": {"method": {}}}}
        >>> FieldPlaces(lambda: ({"properties": properties}, {})).hint("method", "")
        'method belongs in spec: spec.method.'
        """
        holders = [holder for holder in self._holders.get(name, ()) if holder != sent_in]
        if not holders:
            return None
        places = [f"in {holder}: {holder}.{name}" if holder else "at the top of the body" for holder in holders]
        return f"{name} belongs {', or '.join(places)}."

    @cached_property
    def _holders(self) -> dict[str, list[str]]:
        """Paths of the objects that have a field, by the field's name."""
        holders: dict[str, list[str]] = {}
        schema, root = self._declared()
        for holder, name in _fields(schema, root, "", frozenset()):
            if holder not in holders.setdefault(name, []):
                holders[name].append(holder)
        return holders


NO_PLACES = FieldPlaces(lambda: ({}, {}))
"""Places of messages and of parts that are checked alone: hints name no other place."""


def place_path(steps: tuple[str | int, ...]) -> str:
    """Path of a place without the numbers of items.

    >>> place_path(("manifest", "cameras", 3, "offset_s"))
    'manifest.cameras[].offset_s'
    """
    return "".join(_ITEM if isinstance(step, int) else f".{step}" for step in steps).removeprefix(".")


def _fields(schema: Schema, root: Schema, path: str, above: frozenset[str]) -> Iterator[tuple[str, str]]:
    """Path of the object and name of each field below ``path``; ``above`` are references that lead there."""
    if "$ref" in schema:
        if schema["$ref"] in above:  # a record that contains records of its own kind
            return
        above |= {schema["$ref"]}
        schema = resolve(schema, root)
    for branch in schema_branches(schema):
        yield from _fields(branch, root, path, above)
    for name, field in schema.get("properties", {}).items():
        yield path, name
        yield from _fields(field, root, f"{path}.{name}" if path else name, above)
    if items := schema.get("items"):
        yield from _fields(items, root, path + _ITEM, above)


_CODES: Mapping[str, Code] = {
    "extra_forbidden": request_codes.UNKNOWN_FIELD,
    "unexpected_keyword_argument": request_codes.UNKNOWN_FIELD,
    "missing": request_codes.MISSING_FIELD,
    "json_invalid": request_codes.MALFORMED_JSON,
    "literal_error": request_codes.VALUE_NOT_ALLOWED,
    "enum": request_codes.VALUE_NOT_ALLOWED,
    "greater_than": request_codes.OUT_OF_RANGE,
    "greater_than_equal": request_codes.OUT_OF_RANGE,
    "less_than": request_codes.OUT_OF_RANGE,
    "less_than_equal": request_codes.OUT_OF_RANGE,
    "finite_number": request_codes.OUT_OF_RANGE,
    "int_parsing_size": request_codes.OUT_OF_RANGE,
    "string_too_short": request_codes.WRONG_LENGTH,
    "string_too_long": request_codes.WRONG_LENGTH,
    "too_short": request_codes.WRONG_LENGTH,
    "too_long": request_codes.WRONG_LENGTH,
    "string_pattern_mismatch": request_codes.WRONG_FORMAT,
    "uuid_parsing": request_codes.WRONG_FORMAT,
    "int_from_float": request_codes.WRONG_TYPE,
    "model_attributes_type": request_codes.WRONG_TYPE,
}
_LIBRARY_TYPES = frozenset(get_args(ErrorType))

_MAX_SHOWN = 100
# Errors that are brought to their fields; each takes some microseconds, and a body has room for thousands.
_MAX_TRANSLATED = 1000

_NOUNS: Mapping[str, str] = {"query": "parameter", "path": "parameter", "header": "header", "cookie": "cookie"}


def model_items(error: ValidationError, model: type[BaseModel], places: FieldPlaces, part: str = "") -> list[ErrorItem]:
    """Translate Pydantic's errors of a model, which is the body or a part of the form.

    ``places``: places of all fields of the body. ``part``: name of the part; empty for the body.
    """
    schema = _model_schema(model)
    # Errors with their inputs would copy a large object once for each field that it lacks.
    errors = error.errors(include_url=False, include_context=False, include_input=False)
    return _items(errors, schema, schema, places, part)


def install(app: FastAPI) -> None:
    """Register the handler that answers wrong bodies and parameters with problems."""
    app.add_exception_handler(RequestValidationError, _handle)


def _handle(request: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)  # noqa: S101 - the framework's signature is wider
    return problem_response(request, _from_validation(request, error))


def _from_validation(request: Request, error: RequestValidationError) -> ApiError:
    details = error.errors()
    if any(detail["type"] == "json_invalid" for detail in details):
        return ApiError(request_codes.MALFORMED_JSON, "The body is not JSON.")
    if isinstance(error.body, bytes):  # a body of another type, which the framework does not parse
        message = "This address accepts application/json."
        return ApiError(request_codes.UNSUPPORTED_MEDIA_TYPE, message, hint="Send Content-Type: application/json.")
    contract = request.app.openapi()
    operation = contract["paths"][request.scope["route"].path][request.scope["method"].lower()]
    in_body = [detail | {"loc": detail["loc"][1:]} for detail in details if detail["loc"][0] == "body"]
    items = _parameter_items([detail for detail in details if detail["loc"][0] != "body"], operation, contract)
    if in_body:
        schema = operation["requestBody"]["content"]["application/json"]["schema"]
        items += _items(in_body, schema, contract, FieldPlaces.declared_for(request, "application/json"))
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
            code=_code(error), message=f"The {_NOUNS[place]} {name} must be {allowed}.", pointer=pointer_to(place, name)
        )
    return list(items.values())


def _items(
    errors: Sequence[ErrorDetails], schema: Schema, root: Schema, places: FieldPlaces, part: str = ""
) -> list[ErrorItem]:
    """Translate errors in JSON, one entry for each field, with pointers below ``part``.

    Only as many fields are translated as an answer lists; an entry at the end says how many more are wrong. Behind many
    errors each place counts as a field, although branches of a union are places of one.
    """
    fields = _Fields(schema, root)
    by_field: dict[Steps, list[ErrorDetails]] = {}
    for error in errors[:_MAX_TRANSLATED]:
        by_field.setdefault(fields.locate(error), []).append(error)
    num_fields = len(by_field) + len({error["loc"] for error in errors[_MAX_TRANSLATED:]})
    items = []
    for steps, field_errors in islice(by_field.items(), MAX_LISTED):
        codes = {_code(error) for error in field_errors}
        if codes == {
            request_codes.VALUE_NOT_ALLOWED,
            request_codes.WRONG_FORMAT,
        }:  # neither a named value nor a name of the user's own
            code = request_codes.VALUE_NOT_ALLOWED
        else:
            code = codes.pop() if len(codes) == 1 else request_codes.INVALID_VALUE
        items.append(_item(field_errors[0], code, steps, fields, places, part))
    return [*items, more_problems(more)] if (more := num_fields - len(items)) else items


class _Fields:
    """Fields that Pydantic's errors are about, with their schemas."""

    def __init__(self, schema: Schema, root: Schema) -> None:
        self.root = root
        self._followed: dict[Steps, tuple[Steps, Schema]] = {(): ((), schema)}

    def locate(self, error: ErrorDetails) -> Steps:
        """Steps to the field of an error."""
        if _code(error) == request_codes.UNKNOWN_FIELD:
            *holder, name = error["loc"]
            return (*self.follow(tuple(holder))[0], name)
        return self.follow(_where(error))[0]

    def follow(self, where: Steps) -> tuple[Steps, Schema]:
        """Follow Pydantic's location; omit steps that name branches of a union instead of fields."""
        if where not in self._followed:
            steps, schema = self.follow(where[:-1])
            inner = _inner(schema, where[-1], self.root)
            self._followed[where] = (steps, schema) if inner is None else ((*steps, where[-1]), inner)
        return self._followed[where]


def _item(error: ErrorDetails, code: Code, steps: Steps, fields: _Fields, places: FieldPlaces, part: str) -> ErrorItem:
    """Entry for a wrong field, by one of its errors."""
    start = (part,) if part else ()
    pointer, hint = pointer_to(*start, *steps), None
    if _code(error) == request_codes.UNKNOWN_FIELD:
        unknown = str(steps[-1])[:_MAX_SHOWN]
        known = ", ".join(_properties(fields.follow(error["loc"][:-1])[1], fields.root))
        message = f"There is no field {_name((*steps[:-1], unknown), '')} here. The fields are {known}."
        hint = places.hint(unknown, place_path((*start, *steps[:-1])))
    elif error["type"] not in _LIBRARY_TYPES:  # raised by our own validators with a code and a sentence
        message = error["msg"]
    elif _code(error) == request_codes.MALFORMED_JSON:
        message = f"{_name(steps, part)} is not JSON."
    else:
        allowed = requirement(fields.follow(_where(error))[1], fields.root)
        missing = " is missing. It" if _code(error) == request_codes.MISSING_FIELD else ""
        message = f"{_name(steps, part)}{missing} must be {allowed}."
    return ErrorItem(code=code, message=message, pointer=pointer, hint=hint)


def _where(error: ErrorDetails) -> Steps:
    """Location of a wrong field; of a list that is too short the list, not the item that it lacks."""
    where = error["loc"]
    return where[:-1] if _lacks_item(error) else where


def _lacks_item(error: ErrorDetails) -> bool:
    """True if an error is about a list with a fixed number of items that is too short."""
    return error["type"] == "missing" and bool(error["loc"]) and isinstance(error["loc"][-1], int)


def _code(error: ErrorDetails) -> Code:
    kind = "too_short" if _lacks_item(error) else error["type"]
    if kind not in _LIBRARY_TYPES:
        return Code(kind)
    is_type = kind.endswith(("_type", "_parsing"))
    return _CODES.get(kind, request_codes.WRONG_TYPE if is_type else request_codes.INVALID_VALUE)


def _inner(schema: Schema, step: str | int, root: Schema) -> Schema | None:
    """Schema of a field or an item; ``None`` if the schema has no such field."""
    schema = resolve(schema, root)
    if isinstance(step, int):
        items = schema.get("items") or next(iter(schema.get("prefixItems", ())), None)
        if items is not None:
            return dict(items)
    elif step in schema.get("properties", {}):
        return dict(schema["properties"][step])
    inner = (_inner(branch, step, root) for branch in schema_branches(schema))
    return next((schema for schema in inner if schema is not None), None)


def _properties(schema: Schema, root: Schema) -> Iterable[str]:
    schema = resolve(schema, root)
    inner = (name for branch in schema_branches(schema) for name in _properties(branch, root))
    return dict.fromkeys([*schema.get("properties", ()), *inner])


def _name(steps: Steps, part: str) -> str:
    """Name of a field, a part or the body in a sentence."""
    if not steps:
        return f"The part {part}" if part else "The body"
    return path_text(steps)


@cache
def _model_schema(model: type[BaseModel]) -> dict[str, Any]:
    return model.model_json_schema()
