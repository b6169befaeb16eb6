"""Routes of results: list a job's result files, download one file, a range of it, or all files as a zip."""

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
from api.schemas.jobs import ResultList, ResultOut
from worker.jobs.errors import DamagedArtifact, NotFound
from worker.jobs.model import Result

router = APIRouter(prefix="/v1/jobs/{job_id}", tags=["results"])

_BLOCK_BYTES = 2**18
_FILE: dict[str, Any] = {
    "text/plain": {"schema": {"type": "string"}, "example": "HIERARCHY\nROOT Hips\n"},
    "application/json": {"schema": {}, "example": {"schema_version": 1}},
}
_HEADERS = {
    "ETag": {"description": "SHA-256 of the file.", "schema": {"type": "string"}},
    "Content-Disposition": {"description": "Name of the file.", "schema": {"type": "string"}},
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
            "description": "Zip archive of all result files.",
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
    # Compressed while it is sent, in the API's process: the fastest level halves the size of a session's files.
    archive = ZipStream(compress_type=ZIP_DEFLATED, compress_level=1)
    for result in results:
        archive.add(_content(services, result), result.name)
    headers = {"Cache-Control": "private, no-cache", **_attachment(f"{session.name or job_id}.zip")}
    return Stream(iter(archive), headers=headers, media_type="application/zip")


def _content(services: Services, result: Result) -> Generator[bytes, None, None]:
    """Blocks of a file, which is opened with the first block."""
    yield from _blocks(services.artifacts.open(result.key, result.sha256), ByteRange(0, result.num_bytes))


def _require_whole(services: Services, results: Sequence[Result]) -> None:
    """Raise the problem of all damaged files, or of the first missing file."""
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


def opened(services: Services, result: Result) -> BinaryIO:
    """Open a result file, or raise the problem of a missing or damaged file."""
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
        hint="Start another job of its session: it reuses what this job detected in the videos.",
    )


def _require_size(services: Services, result: Result) -> None:
    """Raise the problem of a missing file, or of a file with a wrong size.

    A bucket reports the size of a file without its content, so its SHA-256 is not compared here.
    """
    try:
        num_bytes = services.artifacts.size(result.key)
    except NotFound:
        raise _expired() from None
    if num_bytes != result.num_bytes:
        raise _damaged([result])


def _damaged(results: Sequence[Result]) -> ApiError:
    message = "The stored file does not have the SHA-256 that it was written with."
    return ApiError(
        "result_damaged",
        f"{len(results)} stored result files are damaged."
        if len(results) > 1
        else "The stored result file is damaged.",
        errors=[ErrorItem(code="result_damaged", message=message, file=result.name) for result in results],
        hint="Start another job of its session with the same spec: it writes the file again, from verified outputs of "
        "earlier stages.",
    )


@router.get(
    "/results/{name}",
    operation_id="getResult",
    summary="Download a result file",
    response_class=Response,
    responses={
        200: {"description": "Whole file.", "content": _FILE, "headers": _HEADERS},
        206: {"description": "Range of the file.", "content": _FILE, "headers": _HEADERS},
        **NOT_MODIFIED,
        307: {
            "description": "Redirect to the artifact store, which sends the file.",
            "headers": {
                "Location": location("file", "https://bucket.s3.example/jobs/{job_id}/results/{name}?X-Amz-...")
            },
        },
        **problems(404, 409, 410, 416),
    },
)
def get_result(
    job_id: JobId,
    name: Annotated[
        str, Path(description="Name of a result file.", openapi_examples={"bvh": {"value": "person-1.bvh"}})
    ],
    request: Request,
    services: ServicesDep,
    records: RecordsDep,
    range_: Annotated[str | None, Header(alias="Range", description="A single range of bytes.")] = None,
    if_range: Annotated[
        str | None, Header(description="Entity tag for which `Range` applies; else the whole file is sent.")
    ] = None,
    if_none_match: IfNoneMatch = None,
) -> Response:
    """Download a result file: the whole file, or a range, such as the rest of an interrupted download."""
    result = records.results.get(job_id, name)
    etag = f'"{result.sha256}"'
    headers = {
        "ETag": etag,
        "Accept-Ranges": "bytes",
        "Cache-Control": "private, no-cache",
        **_attachment(result.name),
    }
    # A signed address is valid for GET only, so HEAD is answered here.
    signed_s = None if request.scope["state"].get("by_head") else services.settings.signed_downloads_s
    if signed_s and (address := services.artifacts.signed_url(result.key, signed_s)):
        _require_size(services, result)
        return Response(status_code=304, headers=headers) if matches(if_none_match, etag) else RedirectResponse(address)
    with contextlib.ExitStack() as stack:
        file = stack.enter_context(opened(services, result))
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
    return Stream(content, status, headers=headers, media_type=result.media_type, file=file)


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
        """Send the response."""
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
