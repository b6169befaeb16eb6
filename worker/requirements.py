"""Requirements of a JSON Schema on a value, in words for the person who sent another one."""

from collections.abc import Mapping, Sequence
from typing import Any

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


def requirement(schema: Schema, root: Schema, *, null: bool = True) -> str:
    """Put in words what values a schema allows.

    Parameters
    ----------
    root
        The document that references in the schema lead into.
    null
        Whether to name null where it is allowed: not for what can only be sent as text.

    Returns
    -------
        What follows "must be": with all values, limits and fields that are allowed.

    >>> requirement({"anyOf": [{"const": "auto"}, {"type": "integer", "minimum": 1, "maximum": 1000}]}, {})
    'auto, or a whole number from 1 to 1000'
    """
    schema = resolve(schema, root)
    if branches := branches_of(schema):
        examples = {"examples": schema["examples"]} if "examples" in schema else {}
        each = [requirement({**one, **examples}, root) for one in branches if null or one.get("type") != "null"]
        return ", or ".join(dict.fromkeys(each))
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
    """Follow a schema's reference, if it is one."""
    while "$ref" in schema:
        found: Any = root
        for step in schema["$ref"].removeprefix("#/").split("/"):
            found = found[step]
        schema = found
    return schema


def branches_of(schema: Schema) -> Sequence[Schema]:
    """The schemas of which a value has to meet one; empty if the schema is no such choice."""
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
    said = [f"{words} {_number(bound)}" for words, bound in bounds.items() if bound is not None]
    return f" {' and '.join(said)}" if said else ""


def _number(value: float) -> str:
    return str(int(value)) if float(value).is_integer() else repr(value)


def _text(schema: Schema) -> str:
    if schema.get("format") in _FORMATS:
        return _FORMATS[schema["format"]]
    form = f" of the form {schema['pattern']}" if "pattern" in schema else ""
    form = f" such as {schema['examples'][0]}" if "examples" in schema else form
    return f"a text{_size(schema, 'Length', 'characters')}{form}"


def _list(schema: Schema, root: Schema) -> str:
    size = _size(schema, "Items", "items")
    items = schema.get("items") or next(iter(schema.get("prefixItems", ())), None)
    return f"a list{size}, each item {requirement(items, root)}" if items else f"a list{size}"


def _size(schema: Schema, of: str, unit: str) -> str:
    low, high = schema.get(f"min{of}"), schema.get(f"max{of}")
    if low is not None and high is not None:
        return f" of {low} {unit}" if low == high else f" of {low} to {high} {unit}"
    if low is not None:
        return f" of at least {low} {unit}"
    return f" of at most {high} {unit}" if high is not None else ""
