"""Safe parser of OpenCV's FileStorage (YAML, XML, JSON): nested dicts and lists, matrices as nested lists.

OpenCV's own parser is written in C++ and not made for files of strangers. Only the part of YAML that OpenCV writes is
read: no anchors, no aliases, no repeated keys.
"""

import math
import re
from collections.abc import Iterator
from typing import Any

import yaml
from defusedxml.ElementTree import fromstring

from pipeline.core.parsing import UnreadableError, parse, read_unique_json

# 128 cameras with 12 numbers a matrix take some 20,000 events.
_MAX_EVENTS = 200_000
_MAX_DEPTH = 20
_MAX_SIDE = 1000
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,4})?", re.ASCII)
_NOT_FINITE = {".nan": math.nan, ".inf": math.inf, "+.inf": math.inf, "-.inf": -math.inf}
# Both files of EasyMocap list their cameras, which may be more in one of them.
_NAMES = "names"
# OpenCV writes `%YAML:1.0`, which YAML itself does not allow.
_DIRECTIVE = re.compile(r"^%YAML.*$", re.MULTILINE)
_WORD = re.compile(r'"([^"]*)"|(\S+)')


def read_yaml(content: bytes) -> dict[str, Any]:
    """Read the mappings of all documents of a YAML file, joined; raises ``UnreadableError`` for anything else."""
    joined: dict[str, Any] = {}
    for document in parse(_documents, content):
        if not isinstance(document, dict):
            raise UnreadableError
        for key, value in document.items():
            if key in joined and joined[key] != value and key != _NAMES:
                raise UnreadableError(f"{key} has two values")
            joined[key] = value
    return joined


def read_xml(content: bytes) -> dict[str, Any]:
    """Read the mapping of an ``opencv_storage`` element; raises ``UnreadableError`` for anything else."""
    value = _element(parse(fromstring, content), 0)
    if not isinstance(value, dict):
        raise UnreadableError
    return value


def read_object(content: bytes) -> dict[str, Any]:
    """Read a JSON object with FileStorage's matrices; raises ``UnreadableError`` for anything else."""
    value = with_matrices(read_unique_json(content))
    if not isinstance(value, dict):
        raise UnreadableError
    return value


def with_matrices(value: Any, depth: int = 0) -> Any:
    """Replace mappings of rows, cols and data by nested lists, at any depth."""
    if depth > _MAX_DEPTH:
        raise UnreadableError
    if isinstance(value, dict):
        return _mapping({key: with_matrices(entry, depth + 1) for key, entry in value.items()})
    if isinstance(value, list):
        return [with_matrices(entry, depth + 1) for entry in value]
    return value


def _mapping(fields: dict[str, Any]) -> Any:
    if {"rows", "cols", "data"} <= fields.keys():
        return _matrix(fields["rows"], fields["cols"], fields["data"])
    if {"sizes", "dt", "data"} <= fields.keys():  # OpenCV 5 writes rows of numbers so
        sizes = fields["sizes"] if isinstance(fields["sizes"], list) else [fields["sizes"]]
        return _matrix(sizes[0], sizes[1], fields["data"]) if len(sizes) == 2 else _row(sizes, fields["data"])
    return fields


def _row(sizes: list[Any], data: Any) -> list[Any]:
    if len(sizes) != 1 or not isinstance(data, list) or len(data) != _whole(sizes[0]):
        raise UnreadableError
    return data


def _matrix(num_rows: Any, num_cols: Any, data: Any) -> list[list[Any]]:
    rows, cols = _whole(num_rows), _whole(num_cols)
    if not isinstance(data, list) or len(data) != rows * cols:
        raise UnreadableError
    return [data[row * cols : (row + 1) * cols] for row in range(rows)]


def _whole(number: Any) -> int:
    if isinstance(number, bool) or not isinstance(number, (int, float)) or not 0 <= number <= _MAX_SIDE:
        raise UnreadableError
    return int(number)


def _scalar(text: str) -> Any:
    """Number of a plain word, else the word."""
    if text.lower() in _NOT_FINITE:
        return _NOT_FINITE[text.lower()]
    return float(text) if _NUMBER.fullmatch(text) else text


def _documents(content: bytes) -> list[Any]:
    text = _DIRECTIVE.sub("", content.decode("utf-8-sig"))
    # The parser in C is 20 times as fast; it is missing from PyYAML only where that was built without libyaml.
    events = iter(_limited(yaml.parse(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))))
    return [_node(next(events), events, 0) for event in events if isinstance(event, yaml.DocumentStartEvent)]


def _limited(events: Iterator[yaml.Event]) -> Iterator[yaml.Event]:
    for number, event in enumerate(events):
        if number > _MAX_EVENTS or isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None):
            raise UnreadableError
        yield event


def _node(event: yaml.Event, events: Iterator[yaml.Event], depth: int) -> Any:
    if depth > _MAX_DEPTH:
        raise UnreadableError
    if isinstance(event, yaml.ScalarEvent):
        return event.value if event.style else _scalar(event.value)
    if isinstance(event, yaml.SequenceStartEvent):
        items = []
        while not isinstance(event := next(events), yaml.SequenceEndEvent):
            items.append(_node(event, events, depth + 1))
        return items
    if not isinstance(event, yaml.MappingStartEvent):
        raise UnreadableError
    fields: dict[str, Any] = {}
    while not isinstance(event := next(events), yaml.MappingEndEvent):
        if not isinstance(event, yaml.ScalarEvent) or event.value in fields:
            raise UnreadableError
        fields[event.value] = _node(next(events), events, depth + 1)
    return _mapping(fields)


def _element(element: Any, depth: int) -> Any:
    """Value of an XML element: a mapping, a list, a number or a text."""
    if depth > _MAX_DEPTH:
        raise UnreadableError
    tags = [child.tag for child in element]
    if tags and set(tags) == {"_"}:
        return [_element(child, depth + 1) for child in element]
    if tags:
        if len(set(tags)) != len(tags):
            raise UnreadableError
        fields = {child.tag: _element(child, depth + 1) for child in element}
        if "data" in fields and not isinstance(fields["data"], list):
            fields["data"] = [fields["data"]]
        return _mapping(fields)
    words = [quoted or _scalar(plain) for quoted, plain in _WORD.findall(element.text or "")]
    return words[0] if len(words) == 1 else words
