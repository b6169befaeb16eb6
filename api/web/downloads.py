"""Stored files as responses: whole or a range, with strong entity tags, streamed or by the artifact store itself.

Names of downloads tell takes apart, every file system takes them, and a header states them (RFC 6266).
"""

import contextlib
import unicodedata
from collections.abc import AsyncIterator, Generator, Iterator
from dataclasses import dataclass
from typing import Annotated, Any, BinaryIO, Literal, Self
from urllib.parse import quote

from fastapi import Depends, Header, Request, Response
from fastapi.responses import RedirectResponse, StreamingResponse
from starlette.types import Receive, Scope, Send

from api.web.contract.description import location
from api.web.dependencies import Services
from api.web.errors import ApiError, ErrorItem
from api.web.http.conditional import NOT_MODIFIED, ByteRange, IfNoneMatch, matches, select_range
from api.web.http.fair_share import FairThreads
from pipeline.core.problems.request_codes import ARTIFACT_DAMAGED, EXPIRED, RESULT_DAMAGED
from worker.store.errors import DamagedArtifact, NotFound
from worker.store.model.job_records import Result

_BLOCK_BYTES = 2**18
_DAMAGED_HINT = (
    "Start another job of its capture with the same spec: it writes the file again, from verified outputs of earlier "
    "stages."
)

HEADERS: dict[str, Any] = {
    "ETag": {"description": "SHA-256 of the file.", "schema": {"type": "string"}},
    "Content-Disposition": {"description": "Name of the file.", "schema": {"type": "string"}},
    "Accept-Ranges": {"schema": {"type": "string", "const": "bytes"}},
}


@dataclass(frozen=True, slots=True)
class Download:
    """A stored file as clients see it."""

    name: str  # Name under which clients save it
    media_type: str
    # Key in the artifact store, size and digest
    key: str
    num_bytes: int
    sha256: str
    disposition: Literal["attachment", "inline"] = "attachment"
    is_compared: bool = True  # True if the file is compared with its digest when it is opened; else only with its size
    remedy: str | None = None  # Advice if a file that is no result is missing or damaged

    @classmethod
    def from_result(cls, result: Result, name: str | None = None) -> Self:
        """Result file, under its own name or another one."""
        return cls(name or result.name, result.media_type, result.key, result.num_bytes, result.sha256)


@dataclass(frozen=True, slots=True)
class Conditions:
    """Headers of a request that choose what of a file is sent."""

    range: str | None
    if_range: str | None
    if_none_match: str | None


def _conditions(
    range_: Annotated[str | None, Header(alias="Range", description="A single range of bytes.")] = None,
    if_range: Annotated[
        str | None, Header(description="Entity tag for which `Range` applies; else the whole file is sent.")
    ] = None,
    if_none_match: IfNoneMatch = None,
) -> Conditions:
    return Conditions(range_, if_range, if_none_match)


ConditionsDep = Annotated[Conditions, Depends(_conditions)]


def file_responses(content: dict[str, Any], redirect: str | None = None) -> dict[int | str, dict[str, Any]]:
    """Declare the responses of a route that sends a file.

    ``content`` is the file's by media type; ``redirect`` is an example of its path in a bucket that may send it itself.
    """
    sends = {"content": content, "headers": HEADERS}
    responses: dict[int | str, dict[str, Any]] = {
        200: {"description": "Whole file."} | sends,
        206: {"description": "Range of the file."} | sends,
        **NOT_MODIFIED,
    }
    if redirect is not None:
        address = {"Location": location("file") | {"example": f"https://bucket.s3.example/{redirect}?X-Amz-..."}}
        responses[307] = {"description": "Redirect to the artifact store, which sends the file.", "headers": address}
    return responses


def send_file(
    request: Request, services: Services, file: Download, conditions: Conditions, *, may_redirect: bool = True
) -> Response:
    """Answer with a file, or with the range of it that the request asks for.

    Attachments may be sent by the artifact store, at a signed address, unless ``may_redirect`` is false. A file on a
    page is not: its Content-Security-Policy allows the service's own files only.
    """
    etag = f'"{file.sha256}"'
    headers = {
        "ETag": etag,
        "Accept-Ranges": "bytes",
        "Cache-Control": "private, no-cache",
        **content_disposition(file.name, file.disposition),
    }
    # A signed address is valid for GET only, so HEAD is answered here.
    is_signed = may_redirect and file.disposition == "attachment" and not request.scope["state"].get("by_head")
    signed_s = services.settings.signed_downloads_s if is_signed else None
    if signed_s and (address := services.artifacts.signed_url(file.key, signed_s)):
        _require_size(services, file)
        is_known = matches(conditions.if_none_match, etag)
        return Response(status_code=304, headers=headers) if is_known else RedirectResponse(address)
    with contextlib.ExitStack() as stack:
        content = stack.enter_context(opened(services, file))
        if matches(conditions.if_none_match, etag):
            return Response(status_code=304, headers=headers)
        sent, status, sizes = select_range(
            conditions.range if conditions.if_range in {None, etag} else None, file.num_bytes
        )
        stack.pop_all()
    return Stream(file_blocks(content, sent), status, headers=headers | sizes, media_type=file.media_type, file=content)


def opened(services: Services, file: Download) -> BinaryIO:
    """Open a file, or raise the problem of a missing or damaged file."""
    try:
        if file.is_compared:
            return services.artifacts.open(file.key, file.sha256)
        _require_size(services, file)
        return services.artifacts.open(file.key)
    except NotFound:
        raise missing_file(file) from None
    except DamagedArtifact as error:
        raise damaged_file(file) from error


def expired() -> ApiError:
    """Error for a file that was removed."""
    return ApiError(
        EXPIRED,
        "The file was removed.",
        hint="Start another job of its capture: it reuses what this job detected in the videos.",
    )


def damaged(names: list[str]) -> ApiError:
    """Error for stored files that differ from what was written, by their names."""
    message = "The stored file does not have the SHA-256 that it was written with."
    return ApiError(
        RESULT_DAMAGED,
        f"{len(names)} stored result files are damaged." if len(names) > 1 else "The stored result file is damaged.",
        errors=[ErrorItem(code=RESULT_DAMAGED, message=message, file=name) for name in names],
        hint=_DAMAGED_HINT,
    )


def _require_size(services: Services, file: Download) -> None:
    """Raise the problem of a missing file, or of a file with a wrong size.

    A bucket reports the size of a file without its content, so its SHA-256 is not compared here.
    """
    try:
        num_bytes = services.artifacts.size(file.key)
    except NotFound:
        raise missing_file(file) from None
    if num_bytes != file.num_bytes:
        raise damaged_file(file)


def missing_file(file: Download) -> ApiError:
    """Error for a stored file that is missing."""
    return expired() if file.remedy is None else ApiError(EXPIRED, "The file is missing.", hint=file.remedy)


def damaged_file(file: Download) -> ApiError:
    """Error for a stored file that differs from what was written."""
    if file.remedy is None:
        return damaged([file.key.rpartition("/")[2]])
    return ApiError(ARTIFACT_DAMAGED, "The stored file is damaged.", hint=file.remedy)


class Stream(StreamingResponse):
    """Response from a generator, which is closed even if the client disconnects early.

    A generator that was never started, as for HEAD, can't close its ``file``, so the response closes it.
    """

    def __init__(
        self,
        content: Generator[bytes, None, None],
        status_code: int = 200,
        *,
        file: BinaryIO | None = None,
        **options: Any,
    ) -> None:
        super().__init__(content, status_code, **options)
        self._content, self._file = content, file

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the response; its blocks are made in the turns of the caller."""
        services, owner = scope["app"].state.services, scope["state"]["caller"].owner
        self.body_iterator = _in_turns(services.blocks, owner, self._content)
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._content.close()
            if self._file is not None:
                self._file.close()


async def _in_turns(threads: FairThreads, owner: str, content: Iterator[bytes]) -> AsyncIterator[bytes]:
    while (block := await threads.run(owner, next, content, None)) is not None:
        yield block


def file_blocks(file: BinaryIO, sent: ByteRange) -> Generator[bytes, None, None]:
    """Read a range of a file in blocks, and close the file."""
    with file:
        yield from read_blocks(file, sent)


def read_blocks(file: BinaryIO, sent: ByteRange) -> Generator[bytes, None, None]:
    """Read a range of an open file in blocks."""
    file.seek(sent.start)
    left = sent.stop - sent.start
    while left > 0 and (block := file.read(min(left, _BLOCK_BYTES))):
        left -= len(block)
        yield block


_MAX_BYTES = 120
"""Longest name of a take; file systems take names of 255 bytes."""

_MAX_PERSON_BYTES = 60

_KEPT = frozenset(
    "LNM"
)  # first letters of the Unicode categories of letters, numbers, and marks that belong to letters


def take_name(session_name: str) -> str:
    """Name of a take for files: letters and digits of the session's name in lower case, hyphens between words.

    >>> take_name("Handshake, take 3")
    'handshake-take-3'
    """
    return _words(session_name, _MAX_BYTES) or "take"


def _words(text: str, max_bytes: int) -> str:
    """Letters and digits of a text in lower case, hyphens between words; empty without any."""
    lower = unicodedata.normalize("NFC", text.lower())
    words = "".join(char if unicodedata.category(char)[0] in _KEPT else " " for char in lower).split()
    return "-".join(words).encode()[:max_bytes].decode(errors="ignore").rstrip("-")


def download_stem(session_name: str, revision: int = 0) -> str:
    """Beginning of the names of a job's downloads: the take, and the revision of the edits of its people.

    >>> download_stem("Handshake, take 3")
    'handshake-take-3'
    >>> download_stem("Handshake, take 3", revision=2)
    'handshake-take-3_revision-2'
    """
    return take_name(session_name) + (f"_revision-{revision}" if revision else "")


def named_person(person: str, person_name: str | None = None) -> str:
    """Person in the name of a file: the number, and the name that edits gave.

    >>> named_person("person-1", "Anna K.")
    'person-1-anna-k'
    """
    words = "" if person_name in {None, person} else _words(person_name or "", _MAX_PERSON_BYTES)
    return f"{person}-{words}" if words else person


def result_name(session_name: str, name: str, revision: int = 0, person_name: str | None = None) -> str:
    """Name under which clients save a result file of a session.

    >>> result_name("Handshake, take 3", "person-1.bvh")
    'handshake-take-3_person-1.bvh'
    >>> result_name("Handshake, take 3", "person-1.bvh", 2, "Anna")
    'handshake-take-3_revision-2_person-1-anna.bvh'
    >>> result_name("Handshake", "person-1.events.csv", person_name="Anna")
    'handshake_person-1-anna.events.csv'
    >>> result_name("Handshake", "person-1.angles.csv", person_name="Anna")
    'handshake_person-1-anna.angles.csv'
    """
    stem, _, suffix = name.partition(".")
    return f"{download_stem(session_name, revision)}_{named_person(stem, person_name)}.{suffix}"


def archived_name(
    session_name: str, name: str, folder: str | None, revision: int = 0, person_name: str | None = None
) -> str:
    """Path of a result file in the archive of all of them: a folder for each person."""
    inside = "" if folder is None else f"{take_name(named_person(folder, person_name))}/"
    return inside + result_name(session_name, name, revision, person_name)


def content_disposition(name: str, disposition: str = "attachment") -> dict[str, str]:
    """Header with the name of a file: in ASCII, and with all its characters (RFC 6266, section 4.3)."""
    ascii_name = "".join(char if char.isascii() and char.isprintable() and char not in '"\\%' else "_" for char in name)
    both = f"filename=\"{ascii_name}\"; filename*=utf-8''{quote(name, safe='')}"
    return {"Content-Disposition": f"{disposition}; {both}"}
