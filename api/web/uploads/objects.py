"""Uploads in the bucket of the artifacts, which every API process continues.

The bytes of an upload are objects, each a block of the file, named by the positions of its first byte and of the byte
after its last. The offset is the position up to which blocks cover the file without a gap. Blocks are only added, or
replaced by one that covers them, so that the offset never falls; and an object is stored as a whole or not at all.
Two processes to which a client sends the same bytes at once therefore need no lock.
"""

import contextlib
import itertools
import os
import re
import tempfile
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterable, Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, BinaryIO, NamedTuple

import obstore
import structlog
from starlette.concurrency import run_in_threadpool
from uuid_utils import uuid7

from api.web.uploads.spool import UNRECORDED_S, Checksum, Compared, UploadSpool, receive, require_offset
from worker.store.errors import ArtifactsRefused, ArtifactsUnavailable, NotFound
from worker.store.files.disk import DiskSpace
from worker.store.files.s3 import open_bucket, reached
from worker.store.model.session_records import Upload
from worker.store.store import JobStore

_log = structlog.get_logger(__name__)

# Bytes of a full block, and longest time until what has come of one is stored.
_FULL_BYTES = 8 * 2**20
_STORED_S = 2.0
# Blocks that aren't full at the end of an upload, before they become one.
_MAX_SMALL_BLOCKS = 64
# Lists of blocks of one download: another process may replace blocks meanwhile.
_MAX_LISTS = 5
_FOLDER = "uploads"
_NAME = re.compile(rf"{_FOLDER}/[^/]+/(\d{{15}})-(\d{{15}})", re.ASCII)


class _Block(NamedTuple):
    """Bytes of an upload's file from ``start`` to ``end``, exclusive."""

    start: int
    end: int


def _chain(blocks: Iterable[_Block]) -> list[_Block]:
    """Fewest blocks that cover the file from its beginning as far as it is covered."""
    chain: list[_Block] = []
    later = deque(sorted(blocks))
    furthest = _Block(0, 0)
    while True:
        offset = furthest.end
        while later and later[0].start <= offset:
            furthest = max(furthest, later.popleft(), key=lambda block: block.end)
        if furthest.end == offset:
            return chain
        chain.append(furthest)


class SharedUploads(UploadSpool):
    """Objects of uploads in a bucket.

    - ``url``: URL of the artifacts.
    - ``folder``: new folder of this process, for pieces while they arrive, and for files that were put together for a
      session.
    - ``disk``: disk of the folder, whose free space is checked.
    - ``keep_s``: time for which an upload is kept after its last piece. Blocks of uploads that the database does not
      know are removed after it, not at once: a copy of the service may have another database.
    """

    def __init__(self, url: str, folder: Path, disk: DiskSpace, keep_s: float) -> None:
        super().__init__()
        folder.mkdir(parents=True)
        self._store = open_bucket(url)
        self._keep_s = keep_s
        self._folder = folder
        self._disk = disk
        self.name = url

    def create(self, num_bytes: int, upload_id: str | None = None) -> str:
        """Return the id alone, since an upload without bytes has no object; raises 507 if the disk is full."""
        self._disk.require_room()
        return upload_id or str(uuid7())

    def is_here(self, upload: Upload) -> bool:
        """Return whether an upload was begun in the bucket, not in the folder of an API process."""
        return upload.spool == self.name

    def offset(self, upload: Upload) -> int:
        """Bytes of an upload that are in the bucket without a gap; 421 if it was begun in a folder."""
        self.require_here(upload)
        return _end(_chain(self._blocks(upload.id)))

    async def append(self, upload: Upload, offset: int, stream: AsyncIterator[bytes], checksum: Checksum | None) -> int:
        """Append a piece, block by block; one with a checksum waits in a file of its own until it was compared."""
        await run_in_threadpool(self._require_offset, upload, offset)
        most = upload.num_bytes - offset
        with tempfile.TemporaryFile(dir=self._folder) as file:
            sink = _Blocks(self, upload.id, offset, file, self._disk.require_room)
            if checksum is None:
                return offset + await receive(sink, most, stream)
            compared = Compared(_Whole(file, self._disk.require_room), checksum)
            num_bytes = await receive(compared, most, stream)
            compared.require_equal()
            await run_in_threadpool(self._put_all, upload.id, offset, file)
            return offset + num_bytes

    def file(self, upload: Upload) -> Path:
        """Put the file of a complete upload together in the folder, unless it is there already."""
        path = self._folder / upload.id
        try:
            os.utime(path)  # it is in use: ``sweep`` keeps it
        except FileNotFoundError:
            self._disk.require_room(upload.num_bytes)
            with tempfile.NamedTemporaryFile(dir=self._folder) as file:
                for _ in range(_MAX_LISTS):
                    with contextlib.suppress(NotFound):
                        self._download(upload, file)
                        break
                else:
                    raise ArtifactsUnavailable(f"The blocks of the upload {upload.id} change while they are read.")
                with contextlib.suppress(FileExistsError):  # another request was faster
                    os.link(file.name, path)
        return path

    def remove(self, upload_id: str) -> None:
        """Remove the blocks of an upload and its file; unreachable ones are left to ``sweep``."""
        (self._folder / upload_id).unlink(missing_ok=True)
        try:
            self._delete(upload_id, self._blocks(upload_id))
        except (ArtifactsRefused, ArtifactsUnavailable):
            _log.warning("upload_left_in_bucket", upload=upload_id)

    def sweep(self, store: JobStore) -> None:
        """Remove expired uploads, blocks without an upload, and files that no session took, once."""
        expired = self.delete_expired(store)
        for path in self._folder.iterdir():
            with contextlib.suppress(FileNotFoundError):
                if time.time() - path.stat().st_mtime > UNRECORDED_S:
                    path.unlink()
        with reached(self._store, _FOLDER):
            folders = obstore.list_with_delimiter(self._store, _FOLDER)["common_prefixes"]
        ids = {folder.rpartition("/")[2] for folder in folders} | expired
        for upload_id in ids - store.uploads.known(ids):
            if upload_id in expired or self._is_left(upload_id):
                self.remove(upload_id)

    def put(self, upload_id: str, start: int, data: bytes) -> _Block:
        """Store a block."""
        block = _Block(start, start + len(data))
        key = _key(upload_id, block)
        with reached(self._store, key):
            obstore.put(self._store, key, data, use_multipart=False)
        return block

    def join_small(self, upload_id: str) -> None:
        """Replace the last blocks of an upload by one if they are many and not full."""
        found = self._blocks(upload_id)
        chain = _chain(found)
        last = [block for block in chain if block.start >= chain[-1].end - _FULL_BYTES]
        if len(last) <= _MAX_SMALL_BLOCKS:
            return
        data = b"".join(self._read(upload_id, last))
        whole = self.put(upload_id, last[0].start, data)
        covered = [block for block in found if whole.start <= block.start and block.end <= whole.end]
        self._delete(upload_id, [block for block in covered if block != whole])

    def _require_offset(self, upload: Upload, offset: int) -> None:
        self.require_here(upload)
        blocks = self._blocks(upload.id)
        require_offset(_end(_chain(blocks)), offset)
        if len(blocks) > _MAX_SMALL_BLOCKS:
            self.join_small(upload.id)

    def _put_all(self, upload_id: str, offset: int, file: BinaryIO) -> None:
        """Store a file as blocks from ``offset`` on."""
        file.seek(0)
        while data := file.read(_FULL_BYTES):
            offset = self.put(upload_id, offset, data).end

    def _blocks(self, upload_id: str) -> list[_Block]:
        return [block for block, _ in self._listed(upload_id)]

    def _listed(self, upload_id: str) -> list[tuple[_Block, datetime]]:
        """Blocks of an upload with the times at which they were stored."""
        folder = f"{_FOLDER}/{upload_id}"
        with reached(self._store, folder):
            objects = list(itertools.chain.from_iterable(obstore.list(self._store, folder, chunk_size=1000)))
        matches = [(_NAME.fullmatch(found["path"]), found["last_modified"]) for found in objects]
        return [(_Block(int(match[1]), int(match[2])), stored) for match, stored in matches if match is not None]

    def _is_left(self, upload_id: str) -> bool:
        """Return whether the newest block of an upload is older than any upload that receives nothing."""
        now = datetime.now(UTC)
        return all((now - stored).total_seconds() > self._keep_s for _, stored in self._listed(upload_id))

    def _download(self, upload: Upload, file: IO[bytes]) -> None:
        """Write an upload to a file from where the file ends; ``NotFound`` if a block is replaced meanwhile."""
        file.seek(0, os.SEEK_END)
        chain = _chain(self._blocks(upload.id))
        if _end(chain) != upload.num_bytes:
            raise NotFound("Blocks of the upload are missing.")
        for data in self._read(upload.id, chain, file.tell()):
            file.write(data)
            file.flush()

    def _read(self, upload_id: str, chain: Sequence[_Block], offset: int = 0) -> Iterator[bytes]:
        """Bytes of blocks one after another, from ``offset`` on, each once."""
        offset = max(offset, chain[0].start if chain else 0)
        for block in chain:
            if block.end <= offset:
                continue
            key = _key(upload_id, block)
            with reached(self._store, key):
                data = obstore.get_range(self._store, key, start=offset - block.start, end=block.end - block.start)
            offset = block.end
            yield bytes(data)

    def _delete(self, upload_id: str, blocks: Sequence[_Block]) -> None:
        with reached(self._store, upload_id):
            for some in (blocks[start : start + 1000] for start in range(0, len(blocks), 1000)):
                obstore.delete(self._store, [_key(upload_id, block) for block in some])


class _Blocks:
    """Sink that stores a piece block by block; ``file`` holds what has come of a block."""

    def __init__(
        self, uploads: SharedUploads, upload_id: str, offset: int, file: BinaryIO, require_room: Callable[[int], None]
    ) -> None:
        self._uploads, self._upload_id, self._file, self._require_room = uploads, upload_id, file, require_room
        self._start = self._end = offset
        self._put_s = time.monotonic()
        self._num_small = 0

    def write(self, data: bytes) -> None:
        self._require_room(len(data))
        self._file.write(data)
        self._end += len(data)
        if self._end - self._start >= _FULL_BYTES or time.monotonic() > self._put_s + _STORED_S:
            self._put()

    def finish(self) -> None:
        self._put()

    def _put(self) -> None:
        if self._end == self._start:
            return
        self._file.seek(0)
        block = self._uploads.put(self._upload_id, self._start, self._file.read())
        self._file.seek(0)
        self._file.truncate()
        self._start, self._put_s = block.end, time.monotonic()
        self._num_small += block.end - block.start < _FULL_BYTES
        if self._num_small > _MAX_SMALL_BLOCKS:
            self._uploads.join_small(self._upload_id)
            self._num_small = 0


class _Whole:
    """Sink that keeps a piece in a file."""

    def __init__(self, file: BinaryIO, require_room: Callable[[int], None]) -> None:
        self._file, self._require_room = file, require_room

    def write(self, data: bytes) -> None:
        self._require_room(len(data))
        self._file.write(data)

    def finish(self) -> None:
        self._file.flush()


def _end(chain: Sequence[_Block]) -> int:
    return chain[-1].end if chain else 0


def _key(upload_id: str, block: _Block) -> str:
    return f"{_FOLDER}/{upload_id}/{block.start:015d}-{block.end:015d}"
