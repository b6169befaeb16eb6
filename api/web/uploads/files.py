"""Files of uploads on the API's disk, one for each upload: the size of the file is the upload's offset."""

import contextlib
import fcntl
import os
import socket
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import BinaryIO

from starlette.concurrency import run_in_threadpool
from uuid_utils import uuid7

from api.web.uploads import spool
from worker.store.errors import NotFound
from worker.store.files.disk import DiskSpace, sync
from worker.store.model.session_records import Upload
from worker.store.store import JobStore

# Bytes between syncs: at the end of a long piece only the last bytes have to be synced.
_SYNC_BYTES = 64 * 2**20
# Suffix of the file that holds a piece until its checksum was compared.
_PIECE_SUFFIX = ".piece"


class FolderUploads(spool.UploadSpool):
    """Folder of the files of uploads.

    The folder is created if it is missing. ``disk`` is the one whose free space is checked. Pieces whose checksum was
    not compared yet when an earlier process was killed are removed.
    """

    def __init__(self, folder: Path, disk: DiskSpace) -> None:
        super().__init__()
        folder.mkdir(parents=True, exist_ok=True)
        for path in folder.glob(f"*{_PIECE_SUFFIX}"):
            path.unlink()
        self._folder = folder
        self._disk = disk
        self.name = f"{socket.gethostname()}:{folder.absolute()}"

    def create(self, num_bytes: int, upload_id: str | None = None) -> str:
        """Create an empty file and return the id of its upload; raises 507 if the disk has no room for it."""
        self._disk.require_room(num_bytes)
        upload_id = upload_id or str(uuid7())
        self._path(upload_id).open("xb").close()
        sync(self._folder)
        return upload_id

    def is_here(self, upload: Upload) -> bool:
        """Return whether the bytes of an upload are in this folder, not in the folder of another API process.

        A file that is here is served, whatever the upload's row says: folders are shared, moved and restored.
        """
        return upload.spool == self.name or self._path(upload.id).exists()

    def offset(self, upload: Upload) -> int:
        """Bytes of an upload that are on disk; raises ``NotFound`` if there is no file, 421 if it is elsewhere."""
        self.require_here(upload)
        with self._open(upload.id) as file:
            os.fsync(file)
            return os.fstat(file.fileno()).st_size

    async def append(
        self, upload: Upload, offset: int, stream: AsyncIterator[bytes], checksum: spool.Checksum | None
    ) -> int:
        """Append a piece to the file, which other processes that share the folder do not write to meanwhile."""
        target = await run_in_threadpool(self._lock, upload, offset)
        most = upload.num_bytes - offset
        with contextlib.ExitStack() as stack:
            stack.callback(target.close)
            if checksum is None:
                return offset + await spool.receive(_File(target, offset, self._disk.require_room), most, stream)
            piece_path = self._folder / f"{upload.id}{_PIECE_SUFFIX}"
            stack.callback(piece_path.unlink, missing_ok=True)
            with piece_path.open("w+b", buffering=0) as piece:
                compared = spool.Compared(_File(piece, 0, self._disk.require_room), checksum)
                num_bytes = await spool.receive(compared, most, stream)
                compared.require_equal()
                return await run_in_threadpool(_move, piece, target, offset, num_bytes)

    def file(self, upload: Upload) -> Path:
        """Path of an upload's file."""
        return self._path(upload.id)

    def remove(self, upload_id: str) -> None:
        """Remove the file of an upload and the file of its piece, if they exist."""
        for name in (upload_id, f"{upload_id}{_PIECE_SUFFIX}"):
            (self._folder / name).unlink(missing_ok=True)

    def sweep(self, store: JobStore) -> None:
        """Remove expired uploads and files without an upload, once.

        A file is created just before its row in the database and removed after it, so only old files are removed.
        """
        self.delete_expired(store)
        old_ids = {path.name.removesuffix(_PIECE_SUFFIX) for path in self._folder.iterdir() if _is_old(path)}
        for upload_id in old_ids - store.uploads.known(old_ids):
            self.remove(upload_id)

    def _path(self, upload_id: str) -> Path:
        return self._folder / upload_id

    def _open(self, upload_id: str) -> BinaryIO:
        try:
            return self._path(upload_id).open("r+b", buffering=0)
        except FileNotFoundError:
            raise NotFound("There is no such upload.") from None

    def _lock(self, upload: Upload, offset: int) -> BinaryIO:
        self.require_here(upload)
        with contextlib.ExitStack() as stack:
            file = stack.enter_context(self._open(upload.id))
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # other processes may share the folder
            except BlockingIOError:
                raise spool.locked() from None
            spool.require_offset(os.fstat(file.fileno()).st_size, offset)
            stack.pop_all()
        return file


class _File:
    """Sink that writes to an open file from a position on."""

    def __init__(self, file: BinaryIO, offset: int, require_room: Callable[[int], None]) -> None:
        self._file, self._require_room = file, require_room
        self._end = self._synced = offset

    def write(self, data: bytes) -> None:
        self._require_room(len(data))
        _write(self._file, data, self._end)
        self._end += len(data)
        if self._end - self._synced >= _SYNC_BYTES:
            os.fdatasync(self._file)
            self._synced = self._end

    def finish(self) -> None:
        os.fsync(self._file)


def _write(file: BinaryIO, data: bytes, offset: int) -> None:
    view = memoryview(data)
    while view:
        num_bytes = os.pwrite(file.fileno(), view, offset)
        view, offset = view[num_bytes:], offset + num_bytes


def _move(piece: BinaryIO, target: BinaryIO, offset: int, num_bytes: int) -> int:
    """Append a piece whose checksum was compared; return the new offset."""
    for start in range(0, num_bytes, spool.BLOCK_BYTES):
        _write(target, os.pread(piece.fileno(), spool.BLOCK_BYTES, start), offset + start)
    os.fsync(target)
    return offset + num_bytes


def _is_old(path: Path) -> bool:
    try:
        return time.time() - path.stat().st_mtime > spool.UNRECORDED_S
    except FileNotFoundError:
        return False
