"""Uploads on the API's disk: one file each, which holds the bytes that have arrived.

The size of the file is the offset of the upload, and is stored nowhere else. So a client always continues from the
bytes that are there, whenever a process is killed. Bytes are synced to disk before they are acknowledged.
"""

import asyncio
import contextlib
import fcntl
import hashlib
import os
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
from worker.jobs.errors import DamagedDatabase, NotFound
from worker.jobs.files.disk import DiskSpace, sync
from worker.jobs.store import JobStore

_log = structlog.get_logger(__name__)

# Handed to a thread at a time.
_BLOCK_BYTES = 2**20
# On a slow line less is written at once, so that a killed service costs a client a second, not a block.
_BLOCK_S = 1.0
# Synced on the way, so that the end of a long piece does not wait for all of it.
_SYNC_BYTES = 64 * 2**20
_SWEEP_INTERVAL_S = 60.0
# Until a file that was begun must have been recorded.
_UNRECORDED_S = 600.0
# Of a piece with a checksum, until that was compared.
_PIECE_SUFFIX = ".piece"


@dataclass(frozen=True, slots=True)
class Checksum:
    """What a piece must come to."""

    algorithm: str  # of hashlib
    digest: bytes


@dataclass(slots=True)
class _Turn:
    """Whoever writes to an upload."""

    scope: anyio.CancelScope = field(default_factory=anyio.CancelScope)
    over: asyncio.Event = field(default_factory=asyncio.Event)


class UploadSpool:
    """The folder of files on their way.

    Parameters
    ----------
    folder
        Made if it is missing.
    disk
        Where there must be room for what comes.
    """

    def __init__(self, folder: Path, disk: DiskSpace) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._disk = disk
        self._turns: dict[str, _Turn] = {}

    def create(self) -> str:
        """Begin a file; returns the id of its upload, which is to be recorded at once."""
        upload_id = str(uuid7())
        self.path(upload_id).open("xb").close()
        sync(self._folder)
        return upload_id

    def path(self, upload_id: str) -> Path:
        """Where an upload's file is."""
        return self._folder / upload_id

    def offset(self, upload_id: str) -> int:
        """How much of an upload is on disk; ``NotFound`` if it is not here."""
        with self._open(upload_id) as file:
            os.fsync(file)
            return os.fstat(file.fileno()).st_size

    @contextlib.asynccontextmanager
    async def turn(self, upload_id: str) -> AsyncIterator[None]:
        """Be the only one who writes to an upload; who wrote before is stopped, and has 423 raised.

        A client that lost its line comes back before the service has noticed: it must not wait for itself.
        """
        while (other := self._turns.get(upload_id)) is not None:
            other.scope.cancel()
            await other.over.wait()
        mine = self._turns[upload_id] = _Turn()
        try:
            with mine.scope:
                yield
        finally:
            del self._turns[upload_id]
            mine.over.set()
        if mine.scope.cancelled_caught:
            raise _locked()

    async def append(
        self, upload_id: str, offset: int, length: int, stream: AsyncIterator[bytes], checksum: Checksum | None
    ) -> int:
        """Append a piece; within ``turn`` only.

        What comes stays, also when the rest does not; but a piece with a checksum stays as a whole or not at all.

        Parameters
        ----------
        offset
            Where the client believes the file to end.
        length
            Of the whole file.

        Returns
        -------
            The new offset.

        Raises
        ------
        ApiError
            409 at another offset, 413 if more comes than the file is long, 423 if another process writes, 460 if the
            checksum is wrong.
        """
        target = await run_in_threadpool(self._lock, upload_id, offset)
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
                    raise ApiError("checksum_mismatch", "The piece is not what it was when it was sent.")
                return await run_in_threadpool(_move, piece, target, offset, num_bytes)

    def remove(self, upload_id: str) -> None:
        """Remove a file with what was to become part of it; there may be none."""
        for name in (upload_id, f"{upload_id}{_PIECE_SUFFIX}"):
            (self._folder / name).unlink(missing_ok=True)

    def is_written(self, upload_id: str) -> bool:
        """Whether somebody writes to an upload now."""
        return upload_id in self._turns

    async def sweep_forever(self, store: JobStore) -> None:
        """Delete expired uploads, remove files without an upload, and renew the reserve, once a minute."""
        while True:
            try:
                await run_in_threadpool(self._disk.using_reserve, lambda: self.sweep(store))
                await run_in_threadpool(self._disk.set_aside)
            except DamagedDatabase:
                return  # requests answer with the problem
            except Exception:
                _log.exception("upload_sweep_failed")
            await asyncio.sleep(_SWEEP_INTERVAL_S)

    def sweep(self, store: JobStore) -> None:
        """Delete expired uploads and remove files without one. A file is made before its row, and removed after it."""
        for upload_id in store.uploads.expired():
            if not self.is_written(upload_id):
                store.uploads.delete_expired(upload_id)
        found = {path.name.removesuffix(_PIECE_SUFFIX) for path in self._folder.iterdir() if _is_old(path)}
        for upload_id in found - store.uploads.known(found):
            self.remove(upload_id)

    def remove_pieces(self) -> None:
        """Remove what was to be compared when an earlier process was killed."""
        for path in self._folder.glob(f"*{_PIECE_SUFFIX}"):
            path.unlink()

    def _open(self, upload_id: str) -> BinaryIO:
        try:
            return self.path(upload_id).open("r+b", buffering=0)
        except FileNotFoundError:
            raise NotFound("There is no such upload.") from None

    def _lock(self, upload_id: str, offset: int) -> BinaryIO:
        with contextlib.ExitStack() as stack:
            file = stack.enter_context(self._open(upload_id))
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # other processes may have the folder, too
            except BlockingIOError:
                raise _locked() from None
            if (size := os.fstat(file.fileno()).st_size) != offset:
                raise ApiError(
                    "offset_mismatch",
                    f"The upload is at {size} bytes, not at {offset}.",
                    hint="Ask for the offset by HEAD, and go on from there.",
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
    """Write a body to a file from ``offset`` on; returns where it ends.

    What has come is written whatever happens, as long as the disk has room.
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
                raise ApiError("content_too_large", f"The upload was announced to have {length} bytes.")
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
    """Append a piece that was compared."""
    for start in range(0, num_bytes, _BLOCK_BYTES):
        _write(target, os.pread(piece.fileno(), _BLOCK_BYTES, start), offset + start)
    os.fsync(target)
    return offset + num_bytes


def _is_old(path: Path) -> bool:
    try:
        return time.time() - path.stat().st_mtime > _UNRECORDED_S
    except FileNotFoundError:
        return False


def _locked() -> ApiError:
    return ApiError("upload_locked", "Another request writes to this upload.", retryable=True)
