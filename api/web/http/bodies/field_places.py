"""Places of the fields of a request's body, for hints about fields that were sent elsewhere."""

from collections.abc import Callable, Iterator
from functools import cached_property
from typing import Self

from starlette.requests import Request

from pipeline.core.options.requirements import Schema, resolve, schema_branches

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
