"""Conditional and range requests (RFC 9110, sections 13 and 14): entity tags of records, byte ranges of files."""

import functools
import hashlib
import importlib.metadata
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Header, Response
from pydantic import BaseModel

from api.web.errors import ApiError
from pipeline.core.problems.request_codes import CHANGED_MEANWHILE, RANGE_NOT_SATISFIABLE

_ONE_RANGE = re.compile(r"bytes[ \t]*=[ \t]*(\d{0,18})-(\d{0,18})[ \t]*", re.ASCII | re.IGNORECASE)
_ETAG = re.compile(r'(?:W/)?("[^"]*")')

IfNoneMatch = Annotated[str | None, Header(description="Entity tags of the versions that the client has.")]
IfMatch = Annotated[str | None, Header(description="Entity tag of the version that is to be changed; `*` for any.")]

NOT_MODIFIED: dict[int | str, dict[str, Any]] = {304: {"description": "The client has the current version."}}
ETAG = {"ETag": {"description": "Entity tag; it changes whenever the body does.", "schema": {"type": "string"}}}


@dataclass(frozen=True, slots=True)
class ByteRange:
    """Bytes from ``start`` up to ``stop``, which is excluded."""

    start: int
    stop: int


def requested_range(header: str | None, size: int) -> ByteRange | None:
    """Parse a ``Range`` header for content of ``size`` bytes.

    Returns ``None`` for the whole content: without a header, and if the header is malformed, has another unit or
    several ranges. A server may ignore such headers. The range is empty if the content has none of its bytes.

    >>> requested_range("bytes=-100", 1000)
    ByteRange(start=900, stop=1000)
    """
    match = _ONE_RANGE.fullmatch(header or "")
    if match is None or not any(match.groups()):
        return None
    first, last = match.groups()
    if not first:
        return ByteRange(max(0, size - int(last)), size)
    if last and int(last) < int(first):
        return None
    return ByteRange(int(first), min(int(last) + 1, size) if last else size)


def select_range(header: str | None, size: int, noun: str = "file") -> tuple[ByteRange, int, dict[str, str]]:
    """Bytes that a request asks for, with the status and the headers of their answer; raise 416 if there are none.

    ``noun`` names the content in the error.
    """
    wanted = requested_range(header, size)
    if wanted is None:
        return ByteRange(0, size), 200, {"Content-Length": str(size)}
    if wanted.start >= wanted.stop:
        refused = {"Content-Range": f"bytes */{size}"}
        raise ApiError(RANGE_NOT_SATISFIABLE, f"The {noun} has no such range.", headers=refused)
    sizes = {
        "Content-Length": str(wanted.stop - wanted.start),
        "Content-Range": f"bytes {wanted.start}-{wanted.stop - 1}/{size}",
    }
    return wanted, 206, sizes


def matches(header: str | None, etag: str) -> bool:
    """True if an ``If-None-Match`` header names an entity tag or is ``*``."""
    if header is None:
        return False
    return header.strip() == "*" or etag in _ETAG.findall(header)


def conditional(record: BaseModel, if_none_match: str | None) -> Response:
    """Answer with a record and its entity tag, or with 304 if the client has that version."""
    body, etag = _tagged(record)
    return _answer(etag, if_none_match, lambda: body)


def conditional_by(etag: str, record: Callable[[], BaseModel], if_none_match: str | None) -> Response:
    """Answer as ``conditional``, with the tag of ``entity_tag``; the record is made only if the client lacks it."""
    return _answer(etag, if_none_match, lambda: record().model_dump_json().encode())


def entity_tag(*state: object) -> str:
    """Entity tag of a record that is costly to make, from all that it is made of and the version of the service.

    ``repr`` of ``state`` must have all of its content.
    """
    return f'"{hashlib.sha256(repr((_service_version(), *state)).encode()).hexdigest()}"'


@functools.cache
def _service_version() -> str:
    return importlib.metadata.version("multicap")


def _answer(etag: str, if_none_match: str | None, body: Callable[[], bytes]) -> Response:
    headers = {"ETag": etag, "Cache-Control": "private, no-cache"}
    if matches(if_none_match, etag):
        return Response(status_code=304, headers=headers)
    return Response(body(), headers=headers, media_type="application/json")


def require_match(record: BaseModel, if_match: str) -> None:
    """Raise 412 unless the client's version of a record, by its ``If-Match`` header, is the present one."""
    require_tag(_tagged(record)[1], if_match)


def require_tag(etag: str, if_match: str) -> None:
    """Raise 412 unless an ``If-Match`` header names the entity tag of the present version."""
    if not matches(if_match, etag):
        raise ApiError(
            CHANGED_MEANWHILE,
            "The record has changed since this version.",
            hint="Read it again, then send the change with its present ETag.",
        )


def _tagged(record: BaseModel) -> tuple[bytes, str]:
    """JSON of a record, and its entity tag."""
    body = record.model_dump_json().encode()
    return body, f'"{hashlib.sha256(body).hexdigest()}"'
