"""Forms as ``multipart/form-data``: files are streamed to disk and hashed on the way, in constant memory.

Files are written only to the folder that the caller gives.
"""

from pathlib import Path

from python_multipart import MultipartParser
from python_multipart.exceptions import FormParserError
from python_multipart.multipart import parse_options_header
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request

from api.web.errors import ApiError
from api.web.http.bodies.form import Form, FormLimits, Parts, too_large
from api.web.http.bodies.form_kinds import FORM_TYPE, FormKind
from api.web.http.bodies.reading import announced_bytes, blocks, drain
from api.web.http.bodies.validation import FieldPlaces
from pipeline.core.problems.request_codes import MALFORMED_MULTIPART, UNSUPPORTED_MEDIA_TYPE
from worker.store.files.disk import DiskSpace

# Boundaries and headers of the parts, in addition to the bytes of the files.
_ENVELOPE_BYTES = 2**20


async def receive_form(
    request: Request, folder: Path, limits: FormLimits, disk: DiskSpace, kind: FormKind, places: FieldPlaces
) -> Form:
    """Stream a request's form to disk.

    - ``folder``: empty folder, which the caller removes in any case.
    - ``disk``: disk of the folder, whose free space is checked.
    - ``kind``: what is sent.
    - ``places``: places of the fields of the form, for hints.
    - Raises ``ApiError``: 400 if the body can't be parsed, 413 if it is too large, 415 if it is not a form.
    - Raises ``ClientDisconnect`` if the client closes the connection.
    - Raises ``OSError`` if the disk is full.
    """
    boundary = _boundary(request)
    stream = aiter(request.stream())
    try:
        if announced_bytes(request) > limits.max_session_bytes + _ENVELOPE_BYTES:
            raise too_large("session", limits.max_session_bytes)
        disk.require_room(announced_bytes(request))
        parts = Parts(folder, limits, kind, places)
        reader = _Reader(boundary, parts)
        try:
            async for block in blocks(stream):
                disk.require_room(len(block))
                await run_in_threadpool(reader.feed, block)
            return await run_in_threadpool(reader.finish)
        finally:
            parts.close()
    except (ApiError, OSError):
        await drain(stream)
        raise


def _boundary(request: Request) -> str:
    content_type, options = parse_options_header(request.headers.get("content-type"))
    if content_type != FORM_TYPE.encode():
        raise ApiError(UNSUPPORTED_MEDIA_TYPE, f"Files are sent as {FORM_TYPE}.")
    boundary = options.get(b"boundary", b"").decode("latin-1")
    if not boundary:
        raise _malformed()
    return boundary


class _Reader:
    """Parser of the body, with the headers of the current part."""

    def __init__(self, boundary: str, parts: Parts) -> None:
        self._parts = parts
        self._headers: dict[bytes, bytes] = {}
        self._name = b""
        self._value = b""
        self._complete = False
        try:
            self._parser = MultipartParser(
                boundary,
                {
                    "on_part_begin": self._headers.clear,
                    "on_header_field": self._on_header_field,
                    "on_header_value": self._on_header_value,
                    "on_header_end": self._on_header_end,
                    "on_headers_finished": self._on_headers_finished,
                    "on_part_data": lambda data, start, end: parts.write(data[start:end]),
                    "on_part_end": parts.end,
                    "on_end": self._on_end,
                },
            )
        except FormParserError as error:
            raise _malformed() from error

    def feed(self, data: bytes) -> None:
        """Parse the next bytes of the body."""
        try:
            self._parser.write(data)
        except FormParserError as error:
            raise _malformed() from error

    def finish(self) -> Form:
        """Return the form at the end of the body."""
        if not self._complete:
            raise _malformed()
        return self._parts.form()

    def _on_header_field(self, data: bytes, start: int, end: int) -> None:
        self._name += data[start:end]

    def _on_header_value(self, data: bytes, start: int, end: int) -> None:
        self._value += data[start:end]

    def _on_header_end(self) -> None:
        self._headers[self._name.lower()] = self._value
        self._name = self._value = b""

    def _on_headers_finished(self) -> None:
        disposition, options = parse_options_header(self._headers.get(b"content-disposition"))
        if disposition != b"form-data" or b"name" not in options:
            raise _malformed()
        self._parts.begin(_decoded(options[b"name"]), self._file_name(options))

    def _file_name(self, options: dict[bytes, bytes]) -> str | None:
        if b"filename" not in options:
            return None
        name = _decoded(options[b"filename"])
        # The parser removes the folders of a Windows path. Paths are refused, so the backslash is put back.
        as_sent = self._headers[b"content-disposition"].replace(b'\\"', b'"')
        return f"\\{name}" if b"\\" in as_sent and "\\" not in name else name

    def _on_end(self) -> None:
        self._complete = True


def _decoded(value: bytes) -> str:
    # Bytes that are not UTF-8 become lone surrogates, which no name may contain.
    return value.decode(errors="surrogateescape")


def _malformed() -> ApiError:
    return ApiError(MALFORMED_MULTIPART, "The body is not a complete multipart form.")
