"""Place of the bytes of uploads, as routes see it, and the requests that write to it."""

import asyncio
import contextlib
import hashlib
import time
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import anyio
import structlog
from starlette.concurrency import run_in_threadpool

from api.web.errors import ApiError
from pipeline.core.problems import request_codes
from worker.store.errors import DamagedDatabase
from worker.store.files.disk import DiskSpace
from worker.store.model.session_records import Upload
from worker.store.store import JobStore

BLOCK_BYTES = 2**20
"""Bytes that are passed to a thread at once."""

# Longest time between writes: on a slow connection, a killed service costs a client a second instead of a block.
_BLOCK_S = 1.0


@dataclass(frozen=True, slots=True)
class Checksum:
    """Expected checksum of a piece."""

    algorithm: str  # Name of the algorithm in hashlib
    digest: bytes


class Sink(Protocol):
    """Place that a piece is written to, from its beginning to its end."""

    def write(self, data: bytes) -> None:
        """Write the next bytes."""

    def finish(self) -> None:
        """Store for good what was written."""


async def receive(sink: Sink, num_bytes: int, stream: AsyncIterator[bytes]) -> int:
    """Write a body of at most ``num_bytes``; return the bytes that were written.

    Bytes that have arrived are written even if the request fails, as long as there is space. Raises 413 if more come.
    """
    pending: list[bytes] = []
    end, written_s = 0, time.monotonic()

    def write() -> None:
        nonlocal written_s
        data = b"".join(pending)
        pending.clear()
        written_s = time.monotonic()
        sink.write(data)

    def finish() -> None:
        write()
        sink.finish()

    try:
        async for data in stream:
            if end + len(data) > num_bytes:
                raise ApiError(
                    request_codes.CONTENT_TOO_LARGE, "The piece goes beyond the size that was announced for the upload."
                )
            pending.append(data)
            end += len(data)
            if sum(map(len, pending)) >= BLOCK_BYTES or time.monotonic() > written_s + _BLOCK_S:
                await run_in_threadpool(write)
    finally:
        with anyio.CancelScope(shield=True):
            await run_in_threadpool(finish)
    return end


class Compared:
    """Sink that computes the checksum of what is written to another one."""

    def __init__(self, sink: Sink, checksum: Checksum) -> None:
        self._sink, self._expected = sink, checksum.digest
        self._digest = hashlib.new(checksum.algorithm, usedforsecurity=False)

    def write(self, data: bytes) -> None:
        """Write the next bytes."""
        self._sink.write(data)
        self._digest.update(data)

    def finish(self) -> None:
        """Store for good what was written."""
        self._sink.finish()

    def require_equal(self) -> None:
        """Raise 460 unless all that was written has the checksum."""
        if self._digest.digest() != self._expected:
            raise ApiError(
                request_codes.CHECKSUM_MISMATCH, "The piece that arrived does not have the checksum that was sent."
            )


_log = structlog.get_logger(__name__)

_SWEEP_INTERVAL_S = 60.0
UNRECORDED_S = 600.0
"""Age at which bytes without a row in the database are removed: they arrive before it, and go after it."""


class UploadSpool(ABC):
    """Place of the bytes of uploads: a folder of this API process, or a bucket that all API processes share.

    The number of bytes that are stored is the upload's offset and is stored nowhere else, so that it is right after a
    crash at any moment. Bytes are stored for good before they are acknowledged. One request at a time writes an upload.
    """

    name: str
    """Name of the place, kept in the upload's row."""

    def __init__(self) -> None:
        self._scopes: dict[str, tuple[anyio.CancelScope, asyncio.Event]] = {}

    @abstractmethod
    def create(self, num_bytes: int, upload_id: str | None = None) -> str:
        """Make room for an upload, by default with a new id, and return its id; the caller records it at once."""

    @abstractmethod
    def is_here(self, upload: Upload) -> bool:
        """Return whether this process can reach the bytes of an upload."""

    @abstractmethod
    def offset(self, upload: Upload) -> int:
        """Bytes of an upload that are stored; raises ``NotFound`` if it is gone, 421 if it is elsewhere."""

    @abstractmethod
    async def append(self, upload: Upload, offset: int, stream: AsyncIterator[bytes], checksum: Checksum | None) -> int:
        """Append a piece; within ``writing`` only.

        Bytes that arrive before the connection breaks are kept. A piece with a checksum is kept as a whole or not at
        all.

        ``offset``: position of the piece by the client. Returns the new offset of the upload. Raises ``ApiError``: 409
        if the upload has another offset, 413 if the piece goes beyond the file's length, 421 if the bytes are
        elsewhere, 423 if another request writes, 460 if the checksum is wrong.
        """

    @abstractmethod
    def file(self, upload: Upload) -> Path:
        """Path of the file of a complete upload on the disk of the data folder; others may hard-link it."""

    @abstractmethod
    def remove(self, upload_id: str) -> None:
        """Remove the bytes of an upload, if there are any."""

    @abstractmethod
    def sweep(self, store: JobStore) -> None:
        """Remove expired uploads, and bytes without an upload, once."""

    def require_here(self, upload: Upload) -> None:
        """Raise 421 unless ``is_here``; logged with the place of the bytes."""
        if not self.is_here(upload):
            _log.warning("upload_elsewhere", upload=upload.id, spool=upload.spool)
            raise ApiError(
                request_codes.UPLOAD_ELSEWHERE,
                "The bytes of this upload are at another API process.",
                hint="The operator lets all API processes share uploads (MULTICAP_SHARED_UPLOADS), or routes each "
                "client to one process (sticky sessions). Or begin the upload again.",
            )

    @contextlib.asynccontextmanager
    async def writing(self, upload_id: str) -> AsyncIterator[None]:
        """Reserve an upload during the block.

        A client may reconnect before the service notices that its connection broke. The new request must not wait for
        the old one, which is stopped and raises 423.
        """
        while (other := self._scopes.get(upload_id)) is not None:
            other[0].cancel()
            await other[1].wait()
        scope, ended = self._scopes[upload_id] = anyio.CancelScope(), asyncio.Event()
        try:
            with scope:
                yield
        finally:
            del self._scopes[upload_id]
            ended.set()
        if scope.cancelled_caught:
            raise locked()

    def has_writer(self, upload_id: str) -> bool:
        """Return whether a request is writing to an upload."""
        return upload_id in self._scopes

    def delete_expired(self, store: JobStore) -> set[str]:
        """Delete the rows of expired uploads to which no request writes; return their ids."""
        expired = {upload_id for upload_id in store.uploads.expired() if not self.has_writer(upload_id)}
        for upload_id in expired:
            store.uploads.delete_expired(upload_id)
        return expired


async def sweep_forever(spool: UploadSpool, disk: DiskSpace, store: JobStore) -> None:
    """Once a minute, remove what no upload needs, and renew the disk's reserve."""
    while True:
        try:
            await run_in_threadpool(disk.using_reserve, lambda: spool.sweep(store))
            await run_in_threadpool(disk.set_aside)
        except DamagedDatabase:
            return  # requests report the damage
        except Exception:
            _log.exception("upload_sweep_failed")
        await asyncio.sleep(_SWEEP_INTERVAL_S)


def require_offset(found: int, offset: int) -> None:
    """Raise 409 unless an upload is at the offset that a client states."""
    if found != offset:
        raise ApiError(
            request_codes.OFFSET_MISMATCH,
            f"The upload is at {found} bytes, not at {offset}.",
            hint="Ask for the offset with HEAD, and continue from there.",
            retryable=True,
        )


def locked() -> ApiError:
    """Error 423 for an upload to which another request writes."""
    return ApiError(request_codes.UPLOAD_LOCKED, "Another request is writing to this upload.", retryable=True)
