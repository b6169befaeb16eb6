"""Results: what a job made, and the files themselves."""

import contextlib
from collections.abc import Generator, Sequence
from typing import Annotated, Any, BinaryIO
from urllib.parse import quote

from fastapi import APIRouter, Header, Path, Request, Response
from fastapi.responses import RedirectResponse, StreamingResponse
from starlette.types import Receive, Scope, Send
from zipstream import ZIP_DEFLATED, ZipStream

from api.auth import RecordsDep
from api.contract.description import answer, location, problems
from api.dependencies import JobId, Services, ServicesDep
from api.errors import ApiError, ErrorItem
from api.http.byte_ranges import ByteRange, UnsatisfiableRange, matches, requested_range
from api.http.conditional import NOT_MODIFIED, IfNoneMatch
from api.schemas import ResultList, ResultOut
from worker.jobs.errors import DamagedArtifact, NotFound
from worker.jobs.model import Result

router = APIRouter(prefix="/v1/jobs/{job_id}", tags=["results"])

_BLOCK_BYTES = 2**18
_FILE: dict[str, Any] = {
    "text/plain": {"schema": {"type": "string"}, "example": "HIERARCHY\nROOT Hips\n"},
    "application/json": {"schema": {}, "example": {"schema_version": 1}},
}
_HEADERS = {
    "ETag": {"description": "The file's sha256.", "schema": {"type": "string"}},
    "Content-Disposition": {"description": "The file's name.", "schema": {"type": "string"}},
    "Accept-Ranges": {"schema": {"type": "string", "const": "bytes"}},
}


@router.get(
    "/results",
    operation_id="listResults",
    summary="List a job's result files",
    responses={200: answer("ResultList"), **problems(404, 409)},
)
def list_results(job_id: JobId, records: RecordsDep) -> ResultList:
    """List the result files of a finished job."""
    results = records.results.of_job(job_id)
    return ResultList(results=tuple(ResultOut.of(job_id, result) for result in results))


@router.get(
    "/results.zip",
    operation_id="getAllResults",
    summary="Download all result files",
    response_class=Response,
    responses={
        200: {
            "description": "The files under their names.",
            "content": {"application/zip": {"schema": {"type": "string", "format": "binary"}, "example": "PK..."}},
            "headers": {"Content-Disposition": _HEADERS["Content-Disposition"]},
        },
        **problems(404, 409, 410),
    },
)
def get_all_results(job_id: JobId, services: ServicesDep, records: RecordsDep) -> Response:
    """Download all result files of a job as one archive."""
    results = records.results.of_job(job_id)
    _require_whole(services, results)
    session = records.sessions.get(records.jobs.get(job_id).session_id)
    # Made while it is sent, by the API's own processor: the fastest compression, which halves a session's files.
    archive = ZipStream(compress_type=ZIP_DEFLATED, compress_level=1)
    for result in results:
        archive.add(_content(services, result), result.name)
    headers = {"Cache-Control": "private, no-cache", **_attachment(f"{session.name or job_id}.zip")}
    return _Stream(iter(archive), headers=headers, media_type="application/zip")


def _content(services: Services, result: Result) -> Generator[bytes, None, None]:
    """A file's blocks; it is opened for the first one."""
    yield from _blocks(services.artifacts.open(result.key, result.sha256), ByteRange(0, result.num_bytes))


def _require_whole(services: Services, results: Sequence[Result]) -> None:
    """Raise the problem of all files that are damaged, or of one that is missing."""
    damaged = []
    for result in results:
        try:
            services.artifacts.open(result.key, result.sha256).close()
        except NotFound:
            raise _expired() from None
        except DamagedArtifact:
            damaged.append(result)
    if damaged:
        raise _damaged(damaged)


def _opened(services: Services, result: Result) -> BinaryIO:
    """Open a whole file, or raise its problem."""
    try:
        return services.artifacts.open(result.key, result.sha256)
    except NotFound:
        raise _expired() from None
    except DamagedArtifact as error:
        raise _damaged([result]) from error


def _attachment(name: str) -> dict[str, str]:
    return {"Content-Disposition": f"attachment; filename*=utf-8''{quote(name, safe='')}"}


def _expired() -> ApiError:
    return ApiError(
        "expired",
        "The file was removed.",
        hint="Start another job of its session: what this one found in the videos is used again.",
    )


def _require_size(services: Services, result: Result) -> None:
    """Raise the problem of a file that is missing, or longer or shorter than it was: all that the store says of it."""
    try:
        num_bytes = services.artifacts.size(result.key)
    except NotFound:
        raise _expired() from None
    if num_bytes != result.num_bytes:
        raise _damaged([result])


def _damaged(results: Sequence[Result]) -> ApiError:
    message = "The stored file does not have the SHA-256 that it was made with."
    return ApiError(
        "result_damaged",
        f"{len(results)} stored result files are damaged."
        if len(results) > 1
        else "The stored result file is damaged.",
        errors=[ErrorItem(code="result_damaged", message=message, file=result.name) for result in results],
        hint="Start another job of its session with the same spec: it makes the file anew, of stages whose outputs are "
        "verified first.",
    )


@router.get(
    "/results/{name}",
    operation_id="getResult",
    summary="Download a result file",
    response_class=Response,
    responses={
        200: {"description": "The file.", "content": _FILE, "headers": _HEADERS},
        206: {"description": "A range of the file.", "content": _FILE, "headers": _HEADERS},
        **NOT_MODIFIED,
        307: {
            "description": "The store sends it.",
            "headers": {
                "Location": location("file", "https://bucket.s3.example/jobs/{job_id}/results/{name}?X-Amz-...")
            },
        },
        **problems(404, 409, 410, 416),
    },
)
def get_result(
    job_id: JobId,
    name: Annotated[str, Path(description="Name of a result.", openapi_examples={"bvh": {"value": "person-1.bvh"}})],
    request: Request,
    services: ServicesDep,
    records: RecordsDep,
    range_: Annotated[str | None, Header(alias="Range", description="One range of bytes.")] = None,
    if_range: Annotated[str | None, Header(description="Heed `Range` only for this ETag.")] = None,
    if_none_match: IfNoneMatch = None,
) -> Response:
    """Download a result file, whole or from where an earlier download broke off."""
    result = records.results.get(job_id, name)
    etag = f'"{result.sha256}"'
    headers = {
        "ETag": etag,
        "Accept-Ranges": "bytes",
        "Cache-Control": "private, no-cache",
        **_attachment(result.name),
    }
    # A signature is for GET: HEAD is answered here.
    signed_s = None if request.scope["state"].get("by_head") else services.settings.signed_downloads_s
    if signed_s and (address := services.artifacts.signed_url(result.key, signed_s)):
        _require_size(services, result)
        return Response(status_code=304, headers=headers) if matches(if_none_match, etag) else RedirectResponse(address)
    with contextlib.ExitStack() as stack:
        file = stack.enter_context(_opened(services, result))
        if matches(if_none_match, etag):
            return Response(status_code=304, headers=headers)
        try:
            wanted = requested_range(range_, result.num_bytes) if if_range in {None, etag} else None
        except UnsatisfiableRange:
            size = {"Content-Range": f"bytes */{result.num_bytes}"}
            raise ApiError("range_not_satisfiable", "The file has no such range.", headers=size) from None
        stack.pop_all()
    sent = wanted or ByteRange(0, result.num_bytes)
    headers["Content-Length"] = str(sent.stop - sent.start)
    if wanted:
        headers["Content-Range"] = f"bytes {sent.start}-{sent.stop - 1}/{result.num_bytes}"
    content, status = _blocks(file, sent), 206 if wanted else 200
    return _Stream(content, status, headers=headers, media_type=result.media_type, file=file)


class _Stream(StreamingResponse):
    """Sends what a generator gives, and ends it also if the client goes away in the middle.

    A generator that was not begun, as by HEAD, does not close its ``file``: this does.
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
        """Send it."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._content.close()
            if self._file is not None:
                self._file.close()


def _blocks(file: BinaryIO, sent: ByteRange) -> Generator[bytes, None, None]:
    with file:
        file.seek(sent.start)
        left = sent.stop - sent.start
        while left > 0 and (block := file.read(min(left, _BLOCK_BYTES))):
            left -= len(block)
            yield block
