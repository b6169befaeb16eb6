"""Files of uploads on the API's disk, one for each upload.

The size of the file is the upload's offset and is stored nowhere else, so that the offset is right after a crash at any
moment. Bytes are synced to disk before they are acknowledged.
"""

import asyncio
import contextlib
import fcntl
import hashlib
import os
import socket
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import anyio
import structlog
from starlette.concurrency import run_in_threadpool
from uuid_utils import uuid7

from api.errors import ApiError
from pipeline.problem_codes.requests import (
    CHECKSUM_MISMATCH,
    CONTENT_TOO_LARGE,
    OFFSET_MISMATCH,
    UPLOAD_ELSEWHERE,
    UPLOAD_LOCKED,
)
from worker.jobs.errors import DamagedDatabase, NotFound
from worker.jobs.files.disk import DiskSpace, sync
from worker.jobs.model.sessions import Upload
from worker.jobs.store import JobStore

_log = structlog.get_logger(__name__)

# Bytes that are passed to a thread at once.
_BLOCK_BYTES = 2**20
# Longest time between writes: on a slow connection, a killed service costs a client a second instead of a block.
_BLOCK_S = 1.0
# Bytes between syncs: at the end of a long piece only the last bytes have to be synced.
_SYNC_BYTES = 64 * 2**20
_SWEEP_INTERVAL_S = 60.0
# Age at which a file without a row in the database is removed.
_UNRECORDED_S = 600.0
# Suffix of the file that holds a piece until its checksum was compared.
_PIECE_SUFFIX = ".piece"


@dataclass(frozen=True, slots=True)
class Checksum:
    """Expected checksum of a piece."""

    algorithm: str  # Name of the algorithm in hashlib
    digest: bytes


@dataclass(slots=True)
class _Writer:
    """Request that writes to an upload."""

    scope: anyio.CancelScope = field(default_factory=anyio.CancelScope)  # Cancels the request
    ended: asyncio.Event = field(default_factory=asyncio.Event)  # Set when the request no longer writes


class UploadSpool:
    """Folder of the files of uploads.

    The folder is created if it is missing. ``disk`` is the one whose free space is checked.
    """

    def __init__(self, folder: Path, disk: DiskSpace) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._disk = disk
        self.name = f"{socket.gethostname()}:{folder.absolute()}"
        self._writers: dict[str, _Writer] = {}

    def create(self) -> str:
        """Create an empty file and return the id of its upload; the caller records the upload at once."""
        upload_id = str(uuid7())
        self.path(upload_id).open("xb").close()
        sync(self._folder)
        return upload_id

    def path(self, upload_id: str) -> Path:
        """Path of an upload's file."""
        return self._folder / upload_id

    def require_here(self, upload: Upload) -> None:
        """Raise 421 if the bytes of an upload are in the folder of another API process.

        A file that is here is served, whatever the upload's row says: folders are shared, moved and restored.
        """
        if upload.spool in {None, self.name} or self.path(upload.id).exists():
            return
        _log.warning("upload_elsewhere", upload=upload.id, spool=upload.spool)
        raise upload_elsewhere()

    def offset(self, upload: Upload) -> int:
        """Bytes of an upload that are on disk; raises ``NotFound`` if there is no file, 421 if it is elsewhere."""
        self.require_here(upload)
        with self._open(upload.id) as file:
            os.fsync(file)
            return os.fstat(file.fileno()).st_size

    @contextlib.asynccontextmanager
    async def writing(self, upload_id: str) -> AsyncIterator[None]:
        """Reserve an upload for writing during the block; a request that is writing is stopped and raises 423.

        A client may reconnect before the service notices that its connection broke. The new request must not wait for
        the old one.
        """
        while (other := self._writers.get(upload_id)) is not None:
            other.scope.cancel()
            await other.ended.wait()
        writer = self._writers[upload_id] = _Writer()
        try:
            with writer.scope:
                yield
        finally:
            del self._writers[upload_id]
            writer.ended.set()
        if writer.scope.cancelled_caught:
            raise _locked()

    async def append(self, upload: Upload, offset: int, stream: AsyncIterator[bytes], checksum: Checksum | None) -> int:
        """Append a piece; within ``writing`` only.

        Bytes that arrive before the connection breaks are kept. A piece with a checksum is kept as a whole or not at
        all.

        Parameters
        ----------
        offset
            Position of the piece by the client.

        Returns
        -------
            New offset of the upload.

        Raises
        ------
        ApiError
            409 if the upload has another offset, 413 if the piece goes beyond the file's length, 421 if the file is
            elsewhere, 423 if another process writes, 460 if the checksum is wrong.
        """
        upload_id, length = upload.id, upload.num_bytes
        target = await run_in_threadpool(self._lock, upload, offset)
        with contextlib.ExitStack() as stack:
            stack.callback(target.close)
            if checksum is None:
                return await _receive(target, offset, length, stream, self._disk.require_room)
            piece_path = self._folder / f"{upload_id}{_PIECE_SUFFIX}"
            stack.callback(piece_path.unlink, missing_ok=True)
            with piece_path.open("w+b", buffering=0) as piece:
                digest = hashlib.new(checksum.algorithm, usedforsecurity=False)
                num_bytes = await _receive(piece, 0, length - offset, stream, self._disk.require_room, digest.update)
                if digest.digest() != checksum.digest:
                    message = "The piece that arrived does not have the checksum that was sent."
                    raise ApiError(CHECKSUM_MISMATCH, message)
                return await run_in_threadpool(_move, piece, target, offset, num_bytes)

    def remove(self, upload_id: str) -> None:
        """Remove the file of an upload and the file of its piece, if they exist."""
        for name in (upload_id, f"{upload_id}{_PIECE_SUFFIX}"):
            (self._folder / name).unlink(missing_ok=True)

    def has_writer(self, upload_id: str) -> bool:
        """Return whether a request is writing to an upload."""
        return upload_id in self._writers

    async def sweep_forever(self, store: JobStore) -> None:
        """Once a minute, remove expired uploads and files without an upload, and renew the disk's reserve."""
        while True:
            try:
                await run_in_threadpool(self._disk.using_reserve, lambda: self.sweep(store))
                await run_in_threadpool(self._disk.set_aside)
            except DamagedDatabase:
                return  # requests report the damage
            except Exception:
                _log.exception("upload_sweep_failed")
            await asyncio.sleep(_SWEEP_INTERVAL_S)

    def sweep(self, store: JobStore) -> None:
        """Remove expired uploads and files without an upload, once.

        A file is created just before its row in the database and removed after it, so only old files are removed.
        """
        for upload_id in store.uploads.expired():
            if not self.has_writer(upload_id):
                store.uploads.delete_expired(upload_id)
        old_ids = {path.name.removesuffix(_PIECE_SUFFIX) for path in self._folder.iterdir() if _is_old(path)}
        for upload_id in old_ids - store.uploads.known(old_ids):
            self.remove(upload_id)

    def remove_pieces(self) -> None:
        """Remove files of pieces that an earlier process left when it was killed."""
        for path in self._folder.glob(f"*{_PIECE_SUFFIX}"):
            path.unlink()

    def _open(self, upload_id: str) -> BinaryIO:
        try:
            return self.path(upload_id).open("r+b", buffering=0)
        except FileNotFoundError:
            raise NotFound("There is no such upload.") from None

    def _lock(self, upload: Upload, offset: int) -> BinaryIO:
        self.require_here(upload)
        with contextlib.ExitStack() as stack:
            file = stack.enter_context(self._open(upload.id))
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # other processes may share the folder
            except BlockingIOError:
                raise _locked() from None
            if (size := os.fstat(file.fileno()).st_size) != offset:
                raise ApiError(
                    OFFSET_MISMATCH,
                    f"The upload is at {size} bytes, not at {offset}.",
                    hint="Ask for the offset with HEAD, and continue from there.",
                    retryable=True,
                )
            stack.pop_all()
        return file


async def _receive(
    file: BinaryIO,
    offset: int,
    length: int,
    stream: AsyncIterator[bytes],
    require_room: Callable[[int], None],
    on_data: Callable[[bytes], None] = lambda _: None,
) -> int:
    """Write a body to a file from ``offset`` on; return the position after its last byte.

    Bytes that have arrived are written even if the request fails, as long as the disk has space.
    """
    pending: list[bytes] = []
    end, synced, written_s = offset, offset, time.monotonic()

    def write() -> None:
        nonlocal synced, written_s
        data = b"".join(pending)
        pending.clear()
        written_s = time.monotonic()
        require_room(len(data))
        on_data(data)
        _write(file, data, end - len(data))
        if end - synced >= _SYNC_BYTES:
            os.fdatasync(file)
            synced = end

    def finish() -> None:
        write()
        os.fsync(file)

    try:
        async for data in stream:
            if end + len(data) > length:
                raise ApiError(CONTENT_TOO_LARGE, f"The upload was announced to have {length} bytes.")
            pending.append(data)
            end += len(data)
            if sum(map(len, pending)) >= _BLOCK_BYTES or time.monotonic() > written_s + _BLOCK_S:
                await run_in_threadpool(write)
    finally:
        with anyio.CancelScope(shield=True):
            await run_in_threadpool(finish)
    return end


def _write(file: BinaryIO, data: bytes, offset: int) -> None:
    view = memoryview(data)
    while view:
        num_bytes = os.pwrite(file.fileno(), view, offset)
        view, offset = view[num_bytes:], offset + num_bytes


def _move(piece: BinaryIO, target: BinaryIO, offset: int, num_bytes: int) -> int:
    """Append a piece whose checksum was compared; return the new offset."""
    for start in range(0, num_bytes, _BLOCK_BYTES):
        _write(target, os.pread(piece.fileno(), _BLOCK_BYTES, start), offset + start)
    os.fsync(target)
    return offset + num_bytes


def _is_old(path: Path) -> bool:
    try:
        return time.time() - path.stat().st_mtime > _UNRECORDED_S
    except FileNotFoundError:
        return False


def upload_elsewhere() -> ApiError:
    """Error 421 for an upload whose bytes another API process has."""
    return ApiError(
        UPLOAD_ELSEWHERE,
        "The bytes of this upload are at another API process.",
        hint="Requests of an upload must reach the process that began it: the operator routes clients to one process "
        "(sticky sessions). Or begin the upload again.",
    )


def _locked() -> ApiError:
    return ApiError(UPLOAD_LOCKED, "Another request is writing to this upload.", retryable=True)
