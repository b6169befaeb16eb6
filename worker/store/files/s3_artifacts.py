"""Artifacts in a bucket of S3, or of another service with its protocol."""

import contextlib
import io
from collections.abc import Callable, Iterator
from datetime import timedelta
from pathlib import Path
from typing import Any, BinaryIO

import obstore
from obstore.exceptions import BaseError
from obstore.store import S3Store

from worker.store.errors import DamagedArtifact, NotFound
from worker.store.files.artifacts import require_key, require_prefix
from worker.store.files.checksums import Verified, no_check, require_file, sha256_of
from worker.store.files.file_cache import FileCache
from worker.store.files.s3 import list_any, open_bucket, reached

# Size of the parts of a large file, and number of parts at once: the memory that a put takes.
_MIN_PART_BYTES = 8 * 2**20
_PARTS_AT_ONCE = 4
# S3 takes 10,000 parts.
_MAX_PARTS = 9_000
_READ_BYTES = 2**20


class S3Artifacts:
    """Artifacts as objects of a bucket.

    ``url`` is that of ``worker.store.files.s3.open_bucket``. ``cache`` has copies of files that have to be on this
    machine's disk.
    """

    def __init__(self, url: str, cache: FileCache) -> None:
        self._store = open_bucket(url)
        self._cache = cache
        self._verified = Verified()

    def put_file(self, key: str, path: Path) -> None:
        """Send a file, in parts if it is large, and remove ``path``."""
        require_key(key)
        num_bytes = path.stat().st_size
        with reached(self._store, key):
            obstore.put(
                self._store,
                key,
                path,
                attributes=_attributes(key),
                chunk_size=max(_MIN_PART_BYTES, num_bytes // _MAX_PARTS),
                max_concurrency=_PARTS_AT_ONCE,
            )
        path.unlink()

    def put_bytes(self, key: str, data: bytes) -> None:
        """Send bytes."""
        require_key(key)
        with reached(self._store, key):
            obstore.put(self._store, key, data, attributes=_attributes(key), max_concurrency=_PARTS_AT_ONCE)

    def open(self, key: str, sha256: str | None = None) -> BinaryIO:
        """Open an object; it is read in pieces, and once more before if it has to be compared."""
        head = self._head(key)
        file = io.BufferedReader(_Object(self._store, key, head["size"], head["e_tag"]), _READ_BYTES)
        version = key, head["size"], head["e_tag"]
        if sha256 is not None and not self._verified.holds(version, sha256):
            if sha256_of(file) != sha256:
                raise DamagedArtifact(key)
            self._verified.add(version, sha256)
            file.seek(0)
        return file

    @contextlib.contextmanager
    def local_path(self, key: str, sha256: str, check: Callable[[], None] = no_check) -> Iterator[Path]:
        """Path of a copy on this machine; a damaged copy is fetched again."""
        num_bytes = self.size(key)
        with contextlib.ExitStack() as stack:
            path = stack.enter_context(self._copy(key, num_bytes))
            try:
                require_file(path, key, sha256, check)
            except DamagedArtifact:
                self._cache.drop(key)
                path = stack.enter_context(self._copy(key, num_bytes))
                require_file(path, key, sha256, check)
            yield path

    def size(self, key: str) -> int:
        """Size of an object in bytes."""
        return int(self._head(key)["size"])

    def exists(self, key: str) -> bool:
        """Whether an object is stored."""
        try:
            self._head(key)
        except NotFound:
            return False
        return True

    def delete(self, key: str) -> None:
        """Remove an object, and its copy on this machine."""
        require_key(key)
        with contextlib.suppress(NotFound), reached(self._store, key):
            obstore.delete(self._store, key)
        self._cache.drop(key)

    def delete_prefix(self, prefix: str) -> None:
        """Remove objects, some hundreds at a time."""
        require_prefix(prefix)
        with reached(self._store, prefix):
            for some in obstore.list(self._store, prefix.removesuffix("/"), chunk_size=1000):
                obstore.delete(self._store, [listed["path"] for listed in some])

    def names(self, prefix: str) -> list[str]:
        """Names up to the next slash of the objects below a prefix."""
        require_prefix(prefix)
        with reached(self._store, prefix):
            listed = obstore.list_with_delimiter(self._store, prefix.removesuffix("/"))
        return sorted(path.removesuffix("/").rpartition("/")[2] for path in listed["common_prefixes"])

    def signed_url(self, key: str, lifetime_s: float) -> str | None:
        """Address at which the object can be downloaded for a while without a key."""
        require_key(key)
        with reached(self._store, key):
            return obstore.sign(self._store, "GET", key, timedelta(seconds=lifetime_s))

    def ping(self) -> bool:
        """Whether the bucket answers."""
        try:
            list_any(self._store)
        except (BaseError, OSError):
            return False
        return True

    def sweep(self) -> None:
        """Remove copies that are not in use."""
        self._cache.sweep()

    def _head(self, key: str) -> Any:
        require_key(key)
        with reached(self._store, key):
            return obstore.head(self._store, key)

    def _copy(self, key: str, num_bytes: int) -> contextlib.AbstractContextManager[Path]:
        return self._cache.copy(key, num_bytes, lambda path: self._download(key, path))

    def _download(self, key: str, path: Path) -> None:
        with reached(self._store, key), path.open("wb") as file:
            for block in obstore.get(self._store, key).stream(min_chunk_size=_READ_BYTES):
                file.write(block)


class _Object(io.RawIOBase):
    """Object as a file. If the object is replaced while it is read, reading fails."""

    def __init__(self, store: S3Store, key: str, num_bytes: int, etag: str | None) -> None:
        self._store, self._key, self._num_bytes, self._etag = store, key, num_bytes, etag
        self._offset = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        start = {io.SEEK_SET: 0, io.SEEK_CUR: self._offset, io.SEEK_END: self._num_bytes}[whence]
        self._offset = max(0, start + offset)
        return self._offset

    def readinto(self, buffer: Any) -> int:
        stop = min(self._offset + len(buffer), self._num_bytes)
        if stop <= self._offset:
            return 0
        options: Any = {"range": (self._offset, stop), "if_match": self._etag}
        with reached(self._store, self._key):
            data = obstore.get(self._store, self._key, options=options).bytes()
        buffer[: len(data)] = memoryview(data)
        self._offset += len(data)
        return len(data)


def _attributes(key: str) -> Any:
    # For downloads from a signed address.
    return {"Content-Disposition": f'attachment; filename="{key.rpartition("/")[2]}"'}
