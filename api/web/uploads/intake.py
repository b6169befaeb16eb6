"""Intake of uploads: new ones, and videos that a request names by URLs, which become uploads."""

import contextlib
from collections.abc import Iterator
from urllib.parse import unquote, urlsplit
from uuid import UUID

from api.web.dependencies import Services
from api.web.errors import ApiError, ErrorItem, pointer_to, unprocessable
from api.web.http.bodies.form import name_error
from api.web.http.bodies.form_kinds import VIDEOS, UploadedFootage
from pipeline.core.problems import request_codes
from worker.run.webhooks.addresses import may_be_public, url_fault
from worker.store.model.session_records import Upload
from worker.store.outages import is_perhaps_recorded
from worker.store.tenant_records import TenantRecords

FETCH_RETRY_S = 2
"""Time after which a client asks for a file again that is fetched."""


@contextlib.contextmanager
def begun_upload(
    services: Services,
    records: TenantRecords,
    name: str,
    num_bytes: int = 0,
    metadata: str = "",
    source_url: str | None = None,
) -> Iterator[tuple[TenantRecords, Upload]]:
    """Make the file of an upload and record it; the block gets the open transaction and the upload.

    ``source_url`` is the URL that its file is fetched from; ``None``: the client sends the file.
    """
    uploads, keep_s = services.uploads, services.settings.upload_keep_s
    upload_id = uploads.create(num_bytes)
    try:
        with records.transaction() as work:
            yield work, work.uploads.add(upload_id, name, num_bytes, metadata, keep_s, uploads.name, source_url)
    except BaseException as error:
        if not is_perhaps_recorded(error):
            uploads.remove(upload_id)
        raise


def is_size_unknown(upload: Upload) -> bool:
    """Return whether the source of an upload has not stated its size yet."""
    return upload.source_sha256 is not None and upload.num_bytes == 0


def unfinished(upload: Upload, num_bytes: int) -> str:
    """Sentence about an upload of which some bytes are missing."""
    whole = "an unknown number of" if is_size_unknown(upload) else upload.num_bytes
    return f"Of this upload {num_bytes} of {whole} bytes have come."


def source_name(url: str) -> str:
    """Name of the file at a URL: the last part of its path.

    >>> source_name("https://store.example/take%203/cam%2001.mp4?signature=1")
    'cam 01.mp4'
    """
    return unquote(urlsplit(url).path.rpartition("/")[2])


def source_error(services: Services, url: str, name: str | None, *steps: str | int) -> ErrorItem | None:
    """Error of a URL, or of the name of its file, by default ``source_name``; ``steps`` lead to the URL in the body."""
    fault, code = url_fault(url), request_codes.SOURCE_REFUSED
    if fault is None and not services.settings.fetch_private:
        address = urlsplit(url)
        if address.scheme != "https" or not may_be_public(address.hostname or ""):
            fault = "Files are fetched from public https addresses only."
    if fault is None and (fault := name_error(name or source_name(url))) is not None:
        code = request_codes.FILE_NAME_INVALID
    hint = "POST /v1/uploads/from-url takes a filename." if code == request_codes.FILE_NAME_INVALID else None
    return None if fault is None else ErrorItem(code=code, message=fault, pointer=pointer_to(*steps), hint=hint)


def with_fetched(services: Services, records: TenantRecords, names: UploadedFootage) -> UploadedFootage:
    """Replace URLs of videos by ids of uploads, which are begun unless the same request began them before.

    A failed fetch is reported once: its upload is deleted, so that a repeated request fetches the file again.

    Raises
    ------
    ApiError
        422 with all that is wrong, or 409 until all files are there.
    """
    urls = {index: video for index, video in enumerate(names.videos) if isinstance(video, str)}
    if urls and len(names.videos) > (max_files := services.limits.max_files(VIDEOS)):
        message = f"At most {max_files} videos can be sent."
        raise unprocessable([ErrorItem(code=request_codes.TOO_MANY_VIDEOS, message=message, pointer=f"/{VIDEOS}")])
    wrong = [source_error(services, url, None, VIDEOS, index) for index, url in urls.items()]
    if errors := [error for error in wrong if error is not None]:
        raise unprocessable(errors)
    videos, missing = list(names.videos), []
    for index, url in urls.items():
        upload = records.uploads.find_fetched(url)
        if upload is None:
            with begun_upload(services, records, source_name(url), source_url=url) as (_, upload):
                pass
        videos[index] = UUID(upload.id)
        pointer = pointer_to(VIDEOS, index)
        if (problem := upload.problem) is not None:
            records.uploads.delete(upload.id)
            services.uploads.remove(upload.id)
            errors.append(
                ErrorItem(
                    code=problem.code, message=problem.detail, hint=problem.hint, pointer=pointer, file=upload.name
                )
            )
        elif upload.is_fetching:
            message = unfinished(upload, services.uploads.offset(upload))
            missing.append(
                ErrorItem(code=request_codes.UPLOAD_UNFINISHED, message=message, pointer=pointer, file=upload.name)
            )
    if errors:
        raise unprocessable(errors)
    if missing:
        raise ApiError(
            request_codes.VIDEOS_FETCHING,
            f"{len(missing)} of {len(videos)} videos are not fetched yet.",
            errors=missing,
            hint="Send the same request again after Retry-After, until they are there.",
            retryable=True,
            headers={"Retry-After": str(FETCH_RETRY_S)},
        )
    return names.model_copy(update={"videos": tuple(videos)})
