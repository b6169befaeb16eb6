"""Conditional requests: ``ETag``, ``If-Match`` and ``If-None-Match`` of JSON records (RFC 9110, section 13)."""

import functools
import hashlib
import importlib.metadata
from collections.abc import Callable
from typing import Annotated, Any

from fastapi import Header, Response
from pydantic import BaseModel

from api.web.errors import ApiError
from api.web.http.byte_ranges import matches
from pipeline.core.problems.requests import CHANGED_MEANWHILE

IfNoneMatch = Annotated[str | None, Header(description="Entity tags of the versions that the client has.")]
IfMatch = Annotated[str | None, Header(description="Entity tag of the version that is to be changed; `*` for any.")]

NOT_MODIFIED: dict[int | str, dict[str, Any]] = {304: {"description": "The client has the current version."}}
ETAG = {"ETag": {"description": "Entity tag; it changes whenever the body does.", "schema": {"type": "string"}}}


def conditional(record: BaseModel, if_none_match: str | None) -> Response:
    """Answer with a record and its entity tag, or with 304 if the client has that version."""
    body, etag = _tagged(record)
    return _answer(etag, if_none_match, lambda: body)


def conditional_by(etag: str, record: Callable[[], BaseModel], if_none_match: str | None) -> Response:
    """Answer as ``conditional``, with the tag of ``tag_of``; the record is made only if the client lacks it."""
    return _answer(etag, if_none_match, lambda: record().model_dump_json().encode())


def tag_of(*state: object) -> str:
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
    _, etag = _tagged(record)
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
