"""Conditional requests: ``ETag`` and ``If-None-Match`` of JSON records (RFC 9110, section 13)."""

import hashlib
from typing import Annotated, Any

from fastapi import Header, Response
from pydantic import BaseModel

from api.http.byte_ranges import matches

IfNoneMatch = Annotated[str | None, Header(description="Entity tags of the versions that the client has.")]

NOT_MODIFIED: dict[int | str, dict[str, Any]] = {304: {"description": "The client has the current version."}}
ETAG = {"ETag": {"description": "Entity tag; it changes whenever the body does.", "schema": {"type": "string"}}}


def conditional(record: BaseModel, if_none_match: str | None) -> Response:
    """Answer with a record and its entity tag, or with 304 if the client has that version."""
    body = record.model_dump_json().encode()
    etag = f'"{hashlib.sha256(body).hexdigest()}"'
    headers = {"ETag": etag, "Cache-Control": "private, no-cache"}
    if matches(if_none_match, etag):
        return Response(status_code=304, headers=headers)
    return Response(body, headers=headers, media_type="application/json")
