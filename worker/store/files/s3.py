"""Artifacts in a bucket of S3, or of another service with its protocol, with copies on this machine.

The processes of a machine share the copies: files that have to be on its disk, such as videos.
"""

import contextlib
import fcntl
import hashlib
import io
import os
import re
import time
from collections.abc import Callable, Iterator
from datetime import timedelta
from pathlib import Path
from typing import Any, BinaryIO
from uuid import uuid4

import obstore
from filelock import FileLock
from obstore.exceptions import BaseError, PermissionDeniedError, UnauthenticatedError
from obstore.store import S3Store

from worker.store.errors import ArtifactsRefused, ArtifactsUnavailable, DamagedArtifact, NotFound
from worker.store.files.checksums import Verified, no_check, read_sha256, require_file
from worker.store.files.file_keys import require_key, require_prefix
from worker.store.files.secret_files import S3_KEYS, file_variable

# Callers try again by themselves, so the library need not try for longer.
_RETRY: Any = {"max_retries": 4, "retry_timeout": timedelta(seconds=10)}
# Times without a connection, and without a byte of a response. A part of a large file is sent meanwhile.
_CONNECT_TIMEOUT, _READ_TIMEOUT = "5s", "20s"
# Time of a whole request, a large part on a slow line.
_TIMEOUT = "120s"
# Firewalls forget idle connections after minutes: a new one costs less than one that is dead.
_IDLE_TIMEOUT = "30s"

_STATUS = re.compile(r"status code: (\d{3})")
# Statuses of a store that asks to try again later, or whose object was replaced meanwhile.
_TRY_AGAIN = frozenset({408, 409, 412, 425, 429})
_MISSING = 404
# Message of the library for a bucket of another region.
_REDIRECT = "Received redirect"
_NO_BUCKET = "NoSuchBucket"

# Suffixes of a copy, of its lock, of an incomplete copy, and of an empty file whose time is the last use of the copy.
# The times of the copy itself tell whether its content has changed.
_COPY, _LOCK, _PART, _USED = ".copy", ".lock", ".part", ".used"

# Size of the parts of a large file, and number of parts at once: the memory that a put takes.
_MIN_PART_BYTES = 8 * 2**20
_PARTS_AT_ONCE = 4
# S3 takes 10,000 parts.
_MAX_PARTS = 9_000
_READ_BYTES = 2**20


def open_bucket(url: str) -> S3Store:
    """Bucket at ``s3://bucket`` or ``s3://bucket/prefix``; else ``ValueError`` is raised.

    Keys and address come from the environment: ``AWS_ACCESS_KEY_ID``, ``AWS_SECRET_ACCESS_KEY``, ``AWS_REGION``,
    ``AWS_ENDPOINT_URL``; keys also from files, such as ``AWS_SECRET_ACCESS_KEY_FILE``.
    """
    if not url.startswith("s3://"):
        raise ValueError(f"{url!r} does not begin with s3://")
    # An address without TLS was set on purpose.
    plain = os.environ.get("AWS_ENDPOINT_URL", "").startswith("http://")
    client: Any = {
        "connect_timeout": _CONNECT_TIMEOUT,
        "read_timeout": _READ_TIMEOUT,
        "timeout": _TIMEOUT,
        "pool_idle_timeout": _IDLE_TIMEOUT,
        "allow_http": plain,
    }
    keys: Any = {name.lower(): key for name in S3_KEYS if (key := file_variable(name)) is not None}
    return S3Store.from_url(url, config=keys, client_options=client, retry_config=_RETRY)


@contextlib.contextmanager
def reached(store: S3Store, key: str) -> Iterator[None]:
    """Turn errors of the library at a key into errors of the job store."""
    try:
        yield
    except FileNotFoundError as error:  # raised by the library for a missing object, and for a missing bucket
        if _NO_BUCKET in str(error) or _is_bucket_missing(store):
            raise ArtifactsRefused("The bucket of the artifact store is missing.") from error
        raise NotFound(f"There is no artifact {key}.") from error
    except (BaseError, PermissionError) as error:
        if _is_refusal(error):
            raise ArtifactsRefused(f"The artifact store refuses {key}.") from error
        raise ArtifactsUnavailable(f"The artifact store does not respond at {key}.") from error


def list_any(store: S3Store) -> None:
    """Ask the bucket for any object; raises what the library raises."""
    for _ in obstore.list(store, "ping", chunk_size=1):
        break


def _is_refusal(error: Exception) -> bool:
    """Return whether the store refuses a request that it understood; else it is away, or asks to try again."""
    if isinstance(error, PermissionError | PermissionDeniedError | UnauthenticatedError) or _REDIRECT in str(error):
        return True
    status = _STATUS.search(str(error))
    return status is not None and status[1].startswith("4") and int(status[1]) not in _TRY_AGAIN


def _is_bucket_missing(store: S3Store) -> bool:
    """Return whether the bucket is missing; a response to HEAD does not say so."""
    try:
        list_any(store)
    except (BaseError, OSError) as error:
        status = _STATUS.search(str(error))
        return status is not None and int(status[1]) == _MISSING
    return False


class FileCache:
    """Folder of copies.

    A copy in use is never removed. Other copies are removed when room is needed, the one that was used longest ago
    first, and when they were not used for ``keep_s``: deleted files of the store must not stay here. The folder is made
    when it is needed. ``max_bytes`` is the maximum size of all copies; copies in use at the same time may exceed it.
    """

    def __init__(self, folder: Path, max_bytes: int, keep_s: float) -> None:
        self._folder = folder
        self._max_bytes = max_bytes
        self._keep_s = keep_s

    @contextlib.contextmanager
    def copy(self, key: str, num_bytes: int, fetch: Callable[[Path], None]) -> Iterator[Path]:
        """Path at which a file can be read, inside the block only.

        The file's content under ``key`` never changes, and ``num_bytes`` is its size. ``fetch`` writes it to a path;
        one process at a time calls it, if there is no copy yet.
        """
        self._folder.mkdir(parents=True, exist_ok=True)
        path = self._path(key)
        with FileLock(path.with_suffix(_LOCK)):
            while (pinned := _pin(path)) is None:
                self._fetch(path, num_bytes, fetch)
        with pinned:
            yield path
            path.with_suffix(_USED).touch()

    def drop(self, key: str) -> None:
        """Remove a copy that is damaged or may not stay, even if it is in use."""
        if not self._folder.is_dir():
            return
        path = self._path(key)
        with FileLock(path.with_suffix(_LOCK)):
            path.unlink(missing_ok=True)

    def sweep(self) -> None:
        """Remove copies that were not used for ``keep_s``, and incomplete files of killed processes."""
        for path, info in self._found(_COPY, _PART, _LOCK, _USED):
            if time.time() - _used_s(path, info) > self._keep_s:
                _remove_unused(path)

    def _path(self, key: str) -> Path:
        return self._folder / f"{hashlib.sha256(key.encode()).hexdigest()}{_COPY}"

    def _fetch(self, path: Path, num_bytes: int, fetch: Callable[[Path], None]) -> None:
        self._make_room(num_bytes)
        part = self._folder / f"{uuid4().hex}{_PART}"
        try:
            fetch(part)
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)

    def _make_room(self, num_bytes: int) -> None:
        copies = sorted(self._found(_COPY), key=lambda copy: _used_s(*copy))
        too_many = sum(info.st_size for _, info in copies) + num_bytes - self._max_bytes
        for path, info in copies:
            if too_many <= 0:
                return
            if _remove_unused(path):
                too_many -= info.st_size

    def _found(self, *kinds: str) -> Iterator[tuple[Path, os.stat_result]]:
        if not self._folder.is_dir():
            return
        for path in self._folder.iterdir():
            if path.suffix in kinds:
                with contextlib.suppress(FileNotFoundError):
                    yield path, path.stat()


def _pin(path: Path) -> BinaryIO | None:
    """Open a file that is not removed until it is closed, or this process is killed; ``None`` if it is missing."""
    try:
        file = path.open("rb")
    except FileNotFoundError:
        return None
    fcntl.flock(file, fcntl.LOCK_SH)
    if not path.exists():  # it was removed just before
        file.close()
        return None
    path.with_suffix(_USED).touch()
    return file


def _used_s(path: Path, info: os.stat_result) -> float:
    """Time of a copy's last use; of another file, its last change."""
    try:
        return path.with_suffix(_USED).stat().st_mtime if path.suffix == _COPY else info.st_mtime
    except FileNotFoundError:
        return info.st_mtime


def _remove_unused(path: Path) -> bool:
    """Remove a file unless it is in use; return whether it is removed."""
    try:
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            path.unlink()
    except BlockingIOError:
        return False
    except FileNotFoundError:
        return True
    return True


class S3Artifacts:
    """Artifacts as objects of a bucket.

    ``url`` is a parameter of ``open_bucket``. ``cache`` has copies of files that have to be on this
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
            if read_sha256(file) != sha256:
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
        """True if an object is stored."""
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
        """True if the bucket answers."""
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
