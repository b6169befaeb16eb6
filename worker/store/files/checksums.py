"""SHA-256 of stored files: compared before a file is used, once as long as the file does not change.

The version of a file is its device, inode, size and times of the last changes. A process remembers the versions that it
has compared, so that a file is not read again for every chunk or every range of a download.
"""

import contextlib
import errno
import hashlib
import io
import os
import threading
import time
from collections.abc import Callable, Hashable, Iterator
from pathlib import Path
from typing import NamedTuple, Protocol

from worker.store.errors import DamagedArtifact, NotFound

_BLOCK_BYTES = 2**20
_MAX_REMEMBERED = 10_000
# Two changes within one tick of the file system's clock leave the same times, and a file system sets the times of a
# write before it stores the bytes: a version is relied on once its last change is older than that.
_SETTLED_NS = 100_000_000


class Readable(Protocol):
    """File that is read from its present position on."""

    def readinto(self, buffer: memoryview, /) -> int | None:
        """Fill a buffer; return the number of bytes that were read."""


class FileVersion(NamedTuple):
    """Version of a file, from the file system; other content has another version."""

    device: int
    inode: int
    num_bytes: int
    modified_ns: int
    changed_ns: int

    @property
    def is_settled(self) -> bool:
        """Return whether the last change is complete, and another one would have other times."""
        return time.time_ns() - max(self.modified_ns, self.changed_ns) > _SETTLED_NS


class Verified:
    """Versions of files with their digests; the oldest are forgotten first. ``max_remembered`` is their number."""

    def __init__(self, max_remembered: int = _MAX_REMEMBERED) -> None:
        self._max_remembered = max_remembered
        self._sha256_by_version: dict[Hashable, str] = {}
        self._lock = threading.Lock()

    def holds(self, version: Hashable, sha256: str) -> bool:
        """True if a version was found to have a digest."""
        return self._sha256_by_version.get(version) == sha256

    def add(self, version: Hashable, sha256: str) -> None:
        """Remember the digest of a version."""
        with self._lock:
            if len(self._sha256_by_version) >= self._max_remembered:
                del self._sha256_by_version[next(iter(self._sha256_by_version))]
            self._sha256_by_version[version] = sha256


_verified = Verified()


def no_check() -> None:
    """Callback of a digest that is not to be interrupted."""


@contextlib.contextmanager
def missing_is_not_found(key: str) -> Iterator[None]:
    """Raise ``NotFound`` for an artifact whose file is missing."""
    try:
        yield
    except (FileNotFoundError, IsADirectoryError, NotADirectoryError) as error:
        raise NotFound(f"There is no artifact {key}.") from error


def file_version(descriptor: int) -> FileVersion:
    """Version of an open file."""
    info = os.fstat(descriptor)
    return FileVersion(info.st_dev, info.st_ino, info.st_size, info.st_mtime_ns, info.st_ctime_ns)


def read_sha256(file: Readable, check: Callable[[], None] = no_check) -> str:
    """SHA-256 of the rest of a file, in hexadecimal.

    ``check`` is called after every MiB; an exception from it ends the reading.
    """
    digest = hashlib.sha256()
    buffer = memoryview(bytearray(_BLOCK_BYTES))
    while num_bytes := file.readinto(buffer):
        digest.update(buffer[:num_bytes])
        check()
    return digest.hexdigest()


def require_sha256(descriptor: int, key: str, sha256: str, check: Callable[[], None] = no_check) -> FileVersion | None:
    """Compare an open file with its digest, unless its version was compared before.

    - ``descriptor``: file descriptor; its position stays.
    - ``key``: key of the artifact, for the error.
    - ``sha256``: digest in hexadecimal.
    - ``check``: called while the file is read, as by ``read_sha256``.
    - Returns version of the file that has the digest. None if the file changed so shortly before that it may have other
      bytes without having another version: compare again after reading.
    - Raises ``DamagedArtifact``: the digest is another one, or the disk can't read the file.
    """
    version = file_version(descriptor)
    if _verified.holds(version, sha256):
        return version
    settled = version.is_settled
    try:
        found = _read_descriptor_sha256(descriptor, check)
    except OSError as error:
        if error.errno != errno.EIO:
            raise
        raise DamagedArtifact(key) from error
    if found != sha256:
        raise DamagedArtifact(key)
    if not settled or file_version(descriptor) != version:
        return None
    _verified.add(version, sha256)
    return version


def require_file(path: Path, key: str, sha256: str, check: Callable[[], None] = no_check) -> None:
    """Compare the file at a path, as ``require_sha256`` does; ``NotFound`` if there is none."""
    with missing_is_not_found(key), path.open("rb", buffering=0) as file:
        require_sha256(file.fileno(), key, sha256, check)


def _read_descriptor_sha256(descriptor: int, check: Callable[[], None]) -> str:
    position = os.lseek(descriptor, 0, os.SEEK_CUR)
    os.lseek(descriptor, 0, os.SEEK_SET)
    try:
        with io.FileIO(descriptor, closefd=False) as file:
            return read_sha256(file, check)
    finally:
        os.lseek(descriptor, position, os.SEEK_SET)


class VerifiedFile(io.FileIO):
    """A file that is compared with its digest when it is opened, and again whenever it changes while it is read.

    ``key`` and ``sha256`` are parameters of ``require_sha256``. Raises ``DamagedArtifact``, from ``readinto`` too.
    """

    def __init__(self, path: Path, key: str, sha256: str) -> None:
        super().__init__(path)
        self._key, self._sha256 = key, sha256
        try:
            self._version = require_sha256(self.fileno(), key, sha256)
        except BaseException:
            self.close()
            raise

    def readinto(self, buffer: memoryview, /) -> int:  # type: ignore[override]
        """Fill a buffer with bytes of the file that has the digest."""
        num_bytes = super().readinto(buffer)
        # The hard link of a backup also changes the times of a file, but not its content.
        if file_version(self.fileno()) != self._version:
            self._version = require_sha256(self.fileno(), self._key, self._sha256)
        return num_bytes
