"""Intake of uploads: new ones, and the URLs that their files are fetched from."""

import contextlib
from collections.abc import Iterator
from urllib.parse import unquote, urlsplit

from api.web.dependencies import Services
from api.web.http.bodies.form import name_error
from pipeline.core.problems import request_codes
from pipeline.core.problems.code_group import Code
from worker.run.webhooks.addresses import may_be_public, url_fault
from worker.store.model.session_records import Upload
from worker.store.outages import undo_on_failure
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
    with undo_on_failure() as undo:
        undo.callback(uploads.remove, upload_id)
        with records.transaction() as work:
            yield work, work.uploads.add(upload_id, name, num_bytes, metadata, keep_s, uploads.name, source_url)


def unfinished(upload: Upload, num_bytes: int) -> str:
    """Sentence about an upload of which some bytes are missing."""
    whole = "an unknown number of" if upload.is_size_unknown else upload.num_bytes
    return f"Of this upload {num_bytes} of {whole} bytes have come."


def source_name(url: str) -> str:
    """Name of the file at a URL: the last part of its path.

    >>> source_name("https://store.example/take%203/cam%2001.mp4?signature=1")
    'cam 01.mp4'
    """
    return unquote(urlsplit(url).path.rpartition("/")[2])


def source_fault(services: Services, url: str, name: str | None = None) -> tuple[Code, str, str] | None:
    """Code, sentence and hint of a wrong URL, or of a wrong name of its file, by default ``source_name``."""
    fault = url_fault(url)
    if fault is None and not services.settings.fetch_private:
        address = urlsplit(url)
        if address.scheme != "https" or not may_be_public(address.hostname or ""):
            fault = "Files are fetched from public https addresses only."
    if fault is not None:
        return request_codes.SOURCE_REFUSED, fault, "Send a public https link."
    if (fault := name_error(name or source_name(url))) is not None:
        return request_codes.FILE_NAME_INVALID, fault, "POST /v1/uploads/from-url takes a filename."
    return None
