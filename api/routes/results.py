"""Results: what a job made, and the files themselves."""

from collections.abc import Iterator
from typing import Annotated, Any, BinaryIO
from urllib.parse import quote

from fastapi import APIRouter, Header, Path, Response
from fastapi.responses import StreamingResponse

from api.byte_ranges import ByteRange, UnsatisfiableRange, matches, requested_range
from api.contract import answer, problems
from api.dependencies import JobId, ServicesDep
from api.errors import ApiError
from api.schemas import ResultList, ResultOut
from worker.jobs.errors import NotFound

router = APIRouter(prefix="/v1/jobs/{job_id}/results", tags=["results"])

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


@router.get("", operation_id="listResults", responses={200: answer("ResultList"), **problems(404, 409)})
def list_results(job_id: JobId, services: ServicesDep) -> ResultList:
    """List the result files of a finished job."""
    results = services.store.results(job_id)
    return ResultList(results=tuple(ResultOut.of(job_id, result) for result in results))


@router.get(
    "/{name}",
    operation_id="getResult",
    response_class=Response,
    responses={
        200: {"description": "The file.", "content": _FILE, "headers": _HEADERS},
        206: {"description": "A range of the file.", "content": _FILE, "headers": _HEADERS},
        304: {"description": "The client has it already."},
        **problems(404, 409, 410, 416),
    },
)
def get_result(
    job_id: JobId,
    name: Annotated[str, Path(description="Name of a result.", openapi_examples={"bvh": {"value": "person-1.bvh"}})],
    services: ServicesDep,
    range_: Annotated[str | None, Header(alias="Range", description="One range of bytes.")] = None,
    if_range: Annotated[str | None, Header(description="Heed `Range` only for this ETag.")] = None,
    if_none_match: Annotated[str | None, Header(description="ETags that the client has.")] = None,
) -> Response:
    """Download a result file, whole or from where an earlier download broke off."""
    result = services.store.result(job_id, name)
    etag = f'"{result.sha256}"'
    headers = {
        "ETag": etag,
        "Accept-Ranges": "bytes",
        "Cache-Control": "private, no-cache",
        "Content-Disposition": f"attachment; filename*=utf-8''{quote(result.name, safe='')}",
    }
    if matches(if_none_match, etag):
        return Response(status_code=304, headers=headers)
    try:
        wanted = requested_range(range_, result.num_bytes) if if_range in {None, etag} else None
    except UnsatisfiableRange:
        size = {"Content-Range": f"bytes */{result.num_bytes}"}
        raise ApiError(416, "range_not_satisfiable", "The file has no such range.", headers=size) from None
    try:
        file = services.artifacts.open(result.key)
    except NotFound:
        raise ApiError(410, "expired", "The file was removed.", hint="Retry the job, or start it again.") from None
    sent = wanted or ByteRange(0, result.num_bytes)
    headers["Content-Length"] = str(sent.stop - sent.start)
    if wanted:
        headers["Content-Range"] = f"bytes {sent.start}-{sent.stop - 1}/{result.num_bytes}"
    return StreamingResponse(_blocks(file, sent), 206 if wanted else 200, headers=headers, media_type=result.media_type)


def _blocks(file: BinaryIO, sent: ByteRange) -> Iterator[bytes]:
    with file:
        file.seek(sent.start)
        left = sent.stop - sent.start
        while left > 0 and (block := file.read(min(left, _BLOCK_BYTES))):
            left -= len(block)
            yield block
