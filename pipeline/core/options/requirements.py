"""Requirements of a JSON Schema on a value: what violates them, and words for error messages. Standard library only."""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from numbers import Integral, Real
from typing import Any

from pipeline.core.problems import request_codes
from pipeline.core.problems.code_group import Code

_NOUNS: Mapping[str, str] = {
    "array": "a list",
    "boolean": "true or false",
    "integer": "a whole number",
    "null": "null",
    "number": "a number",
    "object": "an object",
    "string": "a text",
}
_FORMATS: Mapping[str, str] = {
    "date-time": "a time such as 2026-03-01T09:30:00Z",
    "ipvanynetwork": "an IP address or network",
    "path": "a path",
    "uuid": "an id (a UUID)",
}
_ANYTHING = "a JSON value"

Schema = Mapping[str, Any]
Steps = tuple[str | int, ...]


def faults(schema: Schema, value: Any, steps: Steps = ()) -> Iterator[tuple[Steps, Code, Schema]]:
    """Find what violates the schema of a choice: one without references and objects.

    Tuples are lists. NumPy's numbers are numbers, and a whole number may be written as 2.0.

    ``steps``: steps to the value. Yields steps to each wrong value, the code of its problem, and the schema that it
    violates.
    """
    if not (branches := schema_branches(schema)):
        yield from _faults(schema, value, steps)
        return
    others = [branch for branch in branches if branch.get("type") != "null"]
    found = [list(_faults(branch, value, steps)) for branch in others]
    if not all(found) or (value is None and len(others) < len(branches)):
        return
    if len(others) == 1:
        yield from ((place, code, schema if place == steps else of_item) for place, code, of_item in found[0])
        return
    codes = {code for of_branch in found for _, code, _ in of_branch}
    if codes == {
        request_codes.VALUE_NOT_ALLOWED,
        request_codes.WRONG_FORMAT,
    }:  # neither a named value nor a name of the user's own
        yield steps, request_codes.VALUE_NOT_ALLOWED, schema
    else:
        yield steps, codes.pop() if len(codes) == 1 else request_codes.INVALID_VALUE, schema


def _faults(schema: Schema, value: Any, steps: Steps) -> Iterator[tuple[Steps, Code, Schema]]:
    if schema["type"] == "array" and isinstance(value, list | tuple):
        if not schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", math.inf):
            yield steps, request_codes.WRONG_LENGTH, schema
            return
        for index, item in enumerate(value):
            of_item = schema["items"] if "items" in schema else schema["prefixItems"][index]
            yield from faults(of_item, item, (*steps, index))
    elif code := _fault(schema, value):
        yield steps, code, schema


def _fault(schema: Schema, value: Any) -> Code | None:
    """Code of what is wrong with a value that is not a list."""
    match schema:
        case {"enum": names}:
            code: Code | None = request_codes.VALUE_NOT_ALLOWED if value not in names else None
        case {"const": name}:
            code = request_codes.VALUE_NOT_ALLOWED if value != name else None
        case {"type": "string", "pattern": pattern} if isinstance(value, str):
            code = request_codes.WRONG_FORMAT if not re.search(pattern, value) else None
        case {"type": "boolean"} if isinstance(value, bool):
            code = None
        case {"type": "integer" | "number"} if isinstance(value, Real) and not isinstance(value, bool):
            code = _number_fault(schema, value)
        case _:
            code = request_codes.WRONG_TYPE
    return code


def _number_fault(schema: Schema, value: Any) -> Code | None:
    is_whole = isinstance(value, Integral)  # one of any size, which may be no float
    if not (is_whole or math.isfinite(value)):
        return request_codes.OUT_OF_RANGE
    if schema["type"] == "integer" and not (is_whole or float(value).is_integer()):
        return request_codes.WRONG_TYPE
    is_above = value >= schema.get("minimum", -math.inf) and value > schema.get("exclusiveMinimum", -math.inf)
    return None if is_above and value <= schema.get("maximum", math.inf) else request_codes.OUT_OF_RANGE


def path_text(steps: Steps) -> str:
    """Name of a field in a sentence.

    >>> path_text(("cameras", 1, "offset_s"))
    'cameras[1].offset_s'
    """
    return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in steps).removeprefix(".")


def requirement(schema: Schema, root: Schema, *, null: bool = True) -> str:
    """Describe the values that a schema allows.

    ``root``: document that contains the targets of references in the schema. ``null``: whether to mention null where it
    is allowed; false for values that are sent as text. Returns words that follow "must be", with all allowed values,
    limits and fields.

    >>> requirement({"anyOf": [{"const": "auto"}, {"type": "integer", "minimum": 1, "maximum": 1000}]}, {})
    'auto, or a whole number from 1 to 1000'
    """
    schema = resolve(schema, root)
    if branches := schema_branches(schema):
        examples = {"examples": schema["examples"]} if "examples" in schema else {}
        described = [branch for branch in branches if null or branch.get("type") != "null"]
        return ", or ".join(dict.fromkeys(requirement({**branch, **examples}, root) for branch in described))
    if "const" in schema:
        words = str(schema["const"])
    elif "enum" in schema:
        words = f"one of {', '.join(map(str, schema['enum']))}"
    else:
        words = _of_type(schema, root)
    return words


def _of_type(schema: Schema, root: Schema) -> str:
    match schema.get("type"):
        case "integer" | "number" as kind:
            words = f"{_NOUNS[kind]}{_range(schema)}"
        case "string":
            words = _text(schema)
        case "array":
            words = _list(schema, root)
        case "object" if "properties" in schema:
            words = f"an object with some of the fields {', '.join(schema['properties'])}"
        case kind:
            words = _NOUNS.get(str(kind), _ANYTHING)
    return words


def resolve(schema: Schema, root: Schema) -> Schema:
    """Follow the references of a schema to their target."""
    while "$ref" in schema:
        target: Any = root
        for step in schema["$ref"].removeprefix("#/").split("/"):
            target = target[step]
        schema = target
    return schema


def schema_branches(schema: Schema) -> Sequence[Schema]:
    """Alternatives of a schema with ``anyOf`` or ``oneOf``; empty for other schemas."""
    return schema.get("anyOf") or schema.get("oneOf") or ()


def _range(schema: Schema) -> str:
    low, high = schema.get("minimum"), schema.get("maximum")
    if low is not None and high is not None:
        return f" from {_number(low)} to {_number(high)}"
    bounds = {
        "of at least": low,
        "above": schema.get("exclusiveMinimum"),
        "of at most": high,
        "below": schema.get("exclusiveMaximum"),
    }
    described = [f"{words} {_number(bound)}" for words, bound in bounds.items() if bound is not None]
    return f" {' and '.join(described)}" if described else ""


def _number(value: int | float) -> str:
    return str(int(value)) if float(value).is_integer() else repr(value)


def _text(schema: Schema) -> str:
    if schema.get("format") in _FORMATS:
        return _FORMATS[schema["format"]]
    form = f" of the form {schema['pattern']}" if "pattern" in schema else ""
    form = f" such as {schema['examples'][0]}" if "examples" in schema else form
    noun = "a URL" if schema.get("pattern", "").startswith("^http") else "a text"
    return f"{noun}{_size(schema, 'Length', 'characters')}{form}"


def _list(schema: Schema, root: Schema) -> str:
    size = _size(schema, "Items", "items")
    items = schema.get("items") or next(iter(schema.get("prefixItems", ())), None)
    return f"a list{size}, each item {requirement(items, root)}" if items else f"a list{size}"


def _size(schema: Schema, quantity: str, unit: str) -> str:
    low, high = schema.get(f"min{quantity}"), schema.get(f"max{quantity}")
    if low is not None and high is not None:
        return f" of {low} {unit}" if low == high else f" of {low} to {high} {unit}"
    if low is not None:
        return f" of at least {low} {unit}"
    return f" of at most {high} {unit}" if high is not None else ""
