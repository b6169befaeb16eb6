"""Routes of uploads: files in pieces, by tus 1.0.

After an interrupted connection a client continues at the upload's offset.
"""

import base64
import re
from collections.abc import Mapping
from datetime import UTC
from email.utils import format_datetime
from typing import Annotated

from fastapi import APIRouter, Depends, Header, Request, Response, status
from starlette.concurrency import run_in_threadpool

from api.web.auth import UploadsDep
from api.web.contract.description import RETRY_AFTER, Resource, Responses, file_content, location, problems
from api.web.dependencies import Services, ServicesDep, UploadId
from api.web.errors import ApiError, ErrorItem, pointer_to, unprocessable
from api.web.http.bodies.form import name_error, too_large
from api.web.http.bodies.reading import SmallBodyRoute, announced_bytes, drain
from api.web.http.idempotency import Answer, IdempotentRequest, IdempotentRequestDep, IdempotentUploadDep
from api.web.uploads.intake import FETCH_RETRY_S, begun_upload, source_fault, source_name
from api.web.uploads.schemas import UploadSource, UploadState
from api.web.uploads.spool import Checksum
from pipeline.core.problems import request_codes
from worker.store.model.session_records import Upload
from worker.store.tenant_records import TenantRecords

VERSION = "1.0.0"
EXTENSIONS = "creation,creation-with-upload,termination,expiration,checksum"
# Algorithms by their names in the protocol, with their names in hashlib.
CHECKSUMS: Mapping[str, str] = {"sha1": "sha1", "sha256": "sha256", "md5": "md5"}
PIECE_TYPE = "application/offset+octet-stream"

_MAX_METADATA_BYTES = 4096
_MAX_DIGITS = 18
_METADATA_KEY = re.compile(r"[\x21-\x2b\x2d-\x7e]+", re.ASCII)  # no space, no comma

_LENGTH = {"type": "integer", "minimum": 0}
_HEADERS = {
    "Tus-Resumable": {"description": "Version of the protocol.", "schema": {"type": "string"}},
    "Upload-Offset": {"description": "Bytes of the upload that are stored.", "schema": _LENGTH},
    "Upload-Length": {"description": "Bytes of the whole file.", "schema": _LENGTH},
    "Upload-Metadata": {"description": "Metadata as the client sent it.", "schema": {"type": "string"}},
    "Upload-Expires": {
        "description": "Time at which the upload is removed unless another piece arrives.",
        "schema": {"type": "string"},
    },
    "Location": location("upload"),
}


def _answers(code: int, *headers: str) -> Responses:
    return {code: {"headers": {name: _HEADERS[name] for name in ("Tus-Resumable", *headers)}}}


def _require_version(
    tus_resumable: Annotated[
        str | None,
        Header(description="Version of the protocol: 1.0.0.", openapi_examples={"default": {"value": VERSION}}),
    ] = None,
) -> None:
    """Raise 412 for clients of another version of tus."""
    if tus_resumable != VERSION:
        raise ApiError(
            request_codes.TUS_VERSION,
            f"The service uses tus {VERSION}.",
            hint=f"Send Tus-Resumable: {VERSION}.",
            headers={"Tus-Version": VERSION},
        )


router = APIRouter(prefix="/v1/uploads", tags=["uploads"])
# Files that the service fetches from URLs, and the state of any upload.
small = APIRouter(prefix="/v1/uploads", tags=["uploads"], route_class=SmallBodyRoute)
# Routes that need no key: a client's first request.
described = APIRouter(prefix="/v1/uploads", tags=["uploads"])


@described.options("", summary="Describe uploads", status_code=status.HTTP_204_NO_CONTENT)
def describe_uploads(response: Response, services: ServicesDep) -> None:
    """Describe the supported version and extensions of tus, and the largest size of a file."""
    response.headers["Tus-Version"] = VERSION
    response.headers["Tus-Extension"] = EXTENSIONS
    response.headers["Tus-Max-Size"] = str(services.settings.max_file_bytes)
    response.headers["Tus-Checksum-Algorithm"] = ",".join(CHECKSUMS)


@router.post(
    "",
    summary="Begin an upload",
    status_code=status.HTTP_201_CREATED,
    response_class=Response,
    responses={
        **_answers(201, "Location", "Upload-Offset", "Upload-Expires"),
        **problems(400, 408, 409, 412, 413, 415, 421, 422, 423, 460, 507),
    },
)
async def create_upload(
    request: Request,
    services: ServicesDep,
    idempotent: IdempotentUploadDep,
    _: Annotated[None, Depends(_require_version)],
    upload_length: Annotated[str | None, Header(description="Bytes of the whole file.")] = None,
    upload_metadata: Annotated[
        str | None,
        Header(
            description="`filename` and the file's name in base64; a session finds the camera by this name.",
            openapi_examples={"video": {"value": "filename Y2FtXzAubXA0"}},
        ),
    ] = None,
    upload_checksum: Annotated[
        str | None, Header(description="Checksum of the bytes in this request: algorithm and base64.")
    ] = None,
) -> Response:
    """Begin an upload. The request's body may hold the first bytes of the file."""
    length = _natural(upload_length, "Upload-Length")
    if length > services.settings.max_file_bytes:
        error = too_large("file", services.settings.max_file_bytes)
        error.headers["Tus-Max-Size"] = str(services.settings.max_file_bytes)
        raise error
    name = _file_name(upload_metadata or "")
    checksum = _checksum(upload_checksum)
    has_piece = announced_bytes(request) > 0 or "transfer-encoding" in request.headers
    if has_piece:
        _require_piece_type(request)
    response = await run_in_threadpool(_begin, services, idempotent, length, name, upload_metadata)
    if has_piece:
        upload = await run_in_threadpool(
            idempotent.records.uploads.get, response.headers["location"].rpartition("/")[2]
        )
        offset = await run_in_threadpool(services.uploads.offset, upload)
        if offset == 0:  # else this is a repeated request whose piece was stored before
            offset, upload = await _append(request, services, idempotent.records, upload, 0, checksum)
        else:
            await drain(aiter(request.stream()))
        response.headers["Upload-Offset"] = str(offset)
    return response


@router.head(
    "/{upload_id}",
    summary="Read an upload's offset",
    response_class=Response,
    responses={
        **_answers(200, "Upload-Offset", "Upload-Length", "Upload-Metadata", "Upload-Expires"),
        **problems(404, 412, 421),
    },
)
def get_upload(
    upload_id: UploadId, services: ServicesDep, records: UploadsDep, _: Annotated[None, Depends(_require_version)]
) -> Response:
    """Read the offset of an upload, at which a client continues."""
    upload = records.uploads.get(upload_id)
    headers = {
        "Upload-Offset": str(services.uploads.offset(upload)),
        **({"Upload-Defer-Length": "1"} if upload.is_size_unknown else {"Upload-Length": str(upload.num_bytes)}),
    }
    if upload.metadata:
        headers["Upload-Metadata"] = upload.metadata
    return Response(headers=headers | _common_headers(upload))


@router.patch(
    "/{upload_id}",
    summary="Send a piece of an upload",
    status_code=status.HTTP_204_NO_CONTENT,
    response_class=Response,
    responses={
        **_answers(204, "Upload-Offset", "Upload-Expires"),
        **problems(400, 404, 408, 409, 412, 413, 415, 421, 423, 460, 507),
    },
    openapi_extra={"requestBody": {"required": True, "content": file_content([PIECE_TYPE])}},
)
async def continue_upload(
    request: Request,
    upload_id: UploadId,
    services: ServicesDep,
    records: UploadsDep,
    _: Annotated[None, Depends(_require_version)],
    upload_offset: Annotated[
        str | None, Header(description="Position of the piece, which must be the upload's offset.")
    ] = None,
    upload_checksum: Annotated[str | None, Header(description="Checksum of the piece: algorithm and base64.")] = None,
) -> Response:
    """Send a piece of a file.

    Bytes that arrive before a connection breaks are kept, unless the piece has a checksum.
    """
    _require_piece_type(request)
    offset, checksum = _natural(upload_offset, "Upload-Offset"), _checksum(upload_checksum)
    upload = await run_in_threadpool(records.uploads.renew, upload_id, services.settings.upload_keep_s)
    if upload.is_fetching or upload.problem is not None:
        raise ApiError(request_codes.CONFLICT, "The service fetches this upload; it takes no pieces.")
    offset, upload = await _append(request, services, records, upload, offset, checksum)
    return Response(status_code=204, headers={"Upload-Offset": str(offset)} | _common_headers(upload))


@router.delete(
    "/{upload_id}",
    summary="Delete an upload",
    status_code=status.HTTP_204_NO_CONTENT,
    response_class=Response,
    responses={**_answers(204), **problems(404, 412, 421)},
)
async def delete_upload(
    upload_id: UploadId, services: ServicesDep, records: UploadsDep, _: Annotated[None, Depends(_require_version)]
) -> Response:
    """Delete an upload with its file."""
    await run_in_threadpool(_delete, services, records, upload_id)
    async with services.uploads.writing(upload_id):
        await run_in_threadpool(services.uploads.remove, upload_id)
    return Response(status_code=204)


def _delete(services: Services, records: TenantRecords, upload_id: str) -> None:
    services.uploads.require_here(records.uploads.get(upload_id))
    services.disk.using_reserve(lambda: records.uploads.delete(upload_id))


def _begin(services: Services, idempotent: IdempotentRequest, length: int, name: str, metadata: str | None) -> Response:
    """Make the file of an upload and record it."""
    if (earlier := idempotent.begin([length, metadata])) is not None:
        return earlier
    with (
        idempotent.working(),
        begun_upload(services, idempotent.records, name, length, metadata or "") as (work, upload),
    ):
        headers = {"Location": f"/v1/uploads/{upload.id}", **_common_headers(upload)}
        return idempotent.store(work, Answer(201, headers, "")).response()


async def _append(
    request: Request, services: Services, records: TenantRecords, upload: Upload, offset: int, checksum: Checksum | None
) -> tuple[int, Upload]:
    stream = aiter(request.stream())
    try:
        if announced_bytes(request) > upload.num_bytes - offset:
            raise too_large("piece", max(0, upload.num_bytes - offset))
        async with services.uploads.writing(upload.id):
            offset = await services.uploads.append(upload, offset, stream, checksum)
    except (ApiError, OSError):
        await drain(stream)
        raise
    return offset, await run_in_threadpool(records.uploads.renew, upload.id, services.settings.upload_keep_s)


def _common_headers(upload: Upload) -> dict[str, str]:
    expires = format_datetime(upload.expires_at.astimezone(UTC), usegmt=True)
    return {"Upload-Expires": expires}


def _natural(value: str | None, header: str) -> int:
    if value is None or not (value.isascii() and value.isdecimal() and len(value) <= _MAX_DIGITS):
        raise ApiError(request_codes.HEADER_INVALID, f"The header {header} is required and must be a number of bytes.")
    return int(value)


def _require_piece_type(request: Request) -> None:
    if request.headers.get("content-type") != PIECE_TYPE:
        raise ApiError(request_codes.UNSUPPORTED_MEDIA_TYPE, f"A piece must be sent as {PIECE_TYPE}.")


def _file_name(metadata: str) -> str:
    """Name of the file in ``Upload-Metadata``."""
    pairs: dict[str, str] = {}
    if len(metadata) > _MAX_METADATA_BYTES:
        raise _metadata_error(f"Upload-Metadata is longer than {_MAX_METADATA_BYTES} bytes.")
    for pair in filter(None, metadata.split(",")):
        key, _, value = pair.strip().partition(" ")
        if not _METADATA_KEY.fullmatch(key) or key in pairs:
            raise _metadata_error("Upload-Metadata must be pairs of a unique key and base64, separated by commas.")
        pairs[key] = value
    try:
        name = base64.b64decode(pairs.get("filename", ""), validate=True).decode()
    except ValueError:  # raised for letters that are not ASCII, too
        raise _metadata_error("The filename of Upload-Metadata is not base64 of UTF-8.") from None
    if message := name_error(name):
        raise _metadata_error(f"{message} Send the file's name as `filename` in Upload-Metadata.")
    return name


def _metadata_error(message: str) -> ApiError:
    return ApiError(request_codes.METADATA_INVALID, message)


def _checksum(header: str | None) -> Checksum | None:
    if header is None:
        return None
    algorithm, _, digest = header.partition(" ")
    try:
        return Checksum(CHECKSUMS[algorithm], base64.b64decode(digest, validate=True))
    except (KeyError, ValueError):
        names = ", ".join(CHECKSUMS)
        message = f"Upload-Checksum must be one of {names}, a space, and the digest as base64."
        raise ApiError(request_codes.CHECKSUM_INVALID, message) from None


@small.post(
    "/from-url",
    summary="Fetch an upload",
    status_code=status.HTTP_202_ACCEPTED,
    response_model=UploadState,
    responses={
        202: {"headers": {"Location": location("upload"), **RETRY_AFTER}},
        **problems(400, 409, 413, 415, 422, 507),
    },
)
def create_upload_from_url(source: UploadSource, services: ServicesDep, idempotent: IdempotentRequestDep) -> Response:
    """Have the service fetch a file. Read the upload until its state is `finished` or `failed`; delete it to cancel."""
    if (earlier := idempotent.begin(source.model_dump(mode="json"))) is not None:
        return earlier
    with idempotent.working():
        if (fault := source_fault(services, source.url, source.filename)) is not None:
            code, message, hint = fault
            raise unprocessable([ErrorItem(code=code, message=message, pointer=pointer_to("url"), hint=hint)])
        name = source.filename or source_name(source.url)
        with begun_upload(services, idempotent.records, name, source_url=source.url) as (work, upload):
            headers = {"Location": f"/v1/uploads/{upload.id}", "Retry-After": str(FETCH_RETRY_S)}
            body = UploadState.from_upload(upload, 0).model_dump_json()
            answer = idempotent.store(work, Answer(202, headers, body))
    return answer.response()


@small.get("/{upload_id}", summary="Read an upload", responses=problems(400, 404, 421, 422))
def get_upload_state(upload_id: UploadId, services: ServicesDep, records: UploadsDep) -> UploadState:
    """Read the state of an upload: how many of its bytes are there, and the error of a fetch that failed."""
    upload = records.uploads.get(upload_id)
    return UploadState.from_upload(upload, services.uploads.offset(upload))


RESOURCE = Resource(router=router)
DESCRIPTION = Resource(router=described, is_open=True)
FETCHES = Resource(router=small)
