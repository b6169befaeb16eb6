"""Archive files of backups, uncompressed tar, written and read as a stream; and errors as sentences for an operator.

The reader accepts exactly the output of the writer: regular files under plain names, headers and padding in one
canonical form, and at the end ``SHA256SUMS``, in the format of ``sha256sum``, with every member before it. So a change
of any byte is noticed, and so is a missing end.
"""

import contextlib
import hashlib
import sqlite3
import tarfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from sqlalchemy.exc import SQLAlchemyError

from worker.store.errors import DamagedDatabase
from worker.store.files.disk import is_disk_full

CHECKSUMS = "SHA256SUMS"
_BLOCK_BYTES = 2**20
_MAX_NAME_BYTES = 1024
_END = bytes(2 * tarfile.BLOCKSIZE)

OnBytes = Callable[[int], None]


class BackupError(Exception):
    """A backup can't be made, read or restored. ``faults`` holds one sentence for each problem."""

    def __init__(self, *faults: str) -> None:
        super().__init__(" ".join(faults))
        self.faults = faults


class BackupUsageError(BackupError):
    """An argument or a setting can't be used; nothing was done."""


@contextlib.contextmanager
def writing_to(place: Path) -> Iterator[None]:
    """Raise ``BackupError`` if a file or a database can't be written inside the block."""
    try:
        yield
    except DamagedDatabase:
        raise
    except OSError as error:
        if is_disk_full(error):
            raise disk_full(Path(error.filename) if error.filename else place) from error
        raise BackupError(f"{error.filename or place} can't be used: {error.strerror or error}.") from error
    except ImportError as error:
        raise BackupUsageError(f"There is no driver for the database at MULTICAP_DATABASE_URL: {error}.") from error
    except (sqlite3.Error, SQLAlchemyError) as error:
        cause = getattr(error, "orig", error)
        if is_disk_full(error):
            raise disk_full(place) from error
        raise BackupError(f"The database failed: {str(cause).strip()}.") from error


def disk_full(place: Path) -> BackupError:
    """Error of a full disk."""
    return BackupError(f"The disk of {place.parent} is full. Make room there, or choose another folder.")


def _header(name: str, num_bytes: int, time_s: int) -> bytes:
    info = tarfile.TarInfo(name)
    info.size, info.mtime, info.mode = num_bytes, time_s, 0o600
    return info.tobuf(tarfile.GNU_FORMAT, "ascii", "strict")


def _padding(num_bytes: int) -> bytes:
    return bytes(-num_bytes % tarfile.BLOCKSIZE)


@dataclass(frozen=True, slots=True)
class Copied:
    """Result of writing a member. ``is_whole``: whether its source could be read to the end."""

    sha256: str
    is_whole: bool


class ArchiveWriter:
    """Writes an archive.

    All members have the time ``time_s``; ``on_bytes`` is called with the number of bytes after each step.
    """

    def __init__(self, file: BinaryIO, time_s: int, on_bytes: OnBytes) -> None:
        self._file, self._time_s, self._on_bytes = file, time_s, on_bytes
        self._checksums: list[str] = []

    def add(self, name: str, num_bytes: int, source: BinaryIO) -> Copied:
        """Add ``num_bytes`` of a file. Bytes that can't be read are replaced by zeros."""
        self._file.write(_header(name, num_bytes, self._time_s))
        digest, left, is_whole = hashlib.sha256(), num_bytes, True
        while left:
            block = _read(source, min(left, _BLOCK_BYTES)) if is_whole else b""
            if not block:
                is_whole = False
                block = bytes(min(left, _BLOCK_BYTES))
            digest.update(block)
            self._file.write(block)
            self._on_bytes(len(block))
            left -= len(block)
        self._file.write(_padding(num_bytes))
        self._checksums.append(f"{digest.hexdigest()}  {name}\n")
        return Copied(digest.hexdigest(), is_whole)

    def add_bytes(self, name: str, content: bytes) -> None:
        """Add a small member."""
        self._file.write(_header(name, len(content), self._time_s) + content + _padding(len(content)))
        self._checksums.append(f"{hashlib.sha256(content).hexdigest()}  {name}\n")

    def finish(self) -> None:
        """Write the checksums and the end of the archive."""
        self.add_bytes(CHECKSUMS, "".join(self._checksums).encode())
        self._file.write(_END)


def _read(source: BinaryIO, num_bytes: int) -> bytes:
    try:
        return source.read(num_bytes)
    except OSError:
        return b""


@dataclass(frozen=True, slots=True)
class Member:
    """A member of an archive. ``blocks`` has to be read to its end before the next member."""

    name: str
    num_bytes: int
    blocks: Iterator[bytes]


class ArchiveReader:
    """Reads an archive.

    ``on_bytes`` is called with the number of bytes after each step. ``damaged`` are names of members whose checksums
    are wrong; complete after the last member.
    """

    def __init__(self, file: BinaryIO, on_bytes: OnBytes) -> None:
        self._file, self._on_bytes = file, on_bytes
        self._offset = 0
        self._checksums: list[str] = []
        self._names: set[str] = set()
        self.damaged: list[str] = []

    def members(self) -> Iterator[Member]:
        """Read all members but the checksums.

        Raises ``BackupError`` if the archive ends too early, or was not written by ``ArchiveWriter``.
        """
        while True:
            name, num_bytes = self._read_header()
            if name == CHECKSUMS:
                self._check(num_bytes)
                return
            digest = hashlib.sha256()
            yield Member(name, num_bytes, self._blocks(num_bytes, digest.update))
            self._checksums.append(f"{digest.hexdigest()}  {name}\n")

    def _read_header(self) -> tuple[str, int]:
        start = self._offset
        try:
            header = self._exactly(tarfile.BLOCKSIZE)
            info = tarfile.TarInfo.frombuf(header, "ascii", "strict")
            if info.type == tarfile.GNUTYPE_LONGNAME and 0 < info.size <= _MAX_NAME_BYTES:
                padded = self._exactly(info.size + len(_padding(info.size)))
                name = padded[: info.size - 1].decode("ascii")
                last = self._exactly(tarfile.BLOCKSIZE)
                info = tarfile.TarInfo.frombuf(last, "ascii", "strict")
                info.name = name
                header += padded + last
            # Links, devices and other members of tar have other headers.
            if info.size < 0 or header != _header(info.name, info.size, int(info.mtime)):
                raise self._damaged(start)
        except (tarfile.TarError, ValueError) as error:
            raise self._damaged(start) from error
        if info.name in self._names:
            raise BackupError(f"The archive holds {info.name!r} twice: no backup of Multicap does.")
        self._names.add(info.name)
        return info.name, info.size

    def _blocks(self, num_bytes: int, update: Callable[[bytes], None]) -> Iterator[bytes]:
        left = num_bytes
        while left:
            block = self._exactly(min(left, _BLOCK_BYTES))
            update(block)
            left -= len(block)
            yield block
        self._expect(_padding(num_bytes))

    def _check(self, num_bytes: int) -> None:
        """Compare the checksums; nothing may follow them."""
        lines = self._checksums
        if num_bytes != sum(map(len, lines)):
            raise BackupError("The archive's checksums don't fit its members: it is damaged.")
        for line in lines:
            if self._exactly(len(line)) != line.encode():
                self.damaged.append(line.split("  ", 1)[1].rstrip("\n"))
        self._expect(_padding(num_bytes) + _END)
        if self._file.read(1):
            raise self._damaged(self._offset)

    def _expect(self, content: bytes) -> None:
        start = self._offset
        if self._exactly(len(content)) != content:
            raise self._damaged(start)

    def _exactly(self, num_bytes: int) -> bytes:
        try:
            content = self._file.read(num_bytes)
        except OSError as error:
            raise BackupError(f"The archive can't be read at byte {self._offset}: {error.strerror}.") from error
        if len(content) != num_bytes:
            raise BackupError(f"The archive ends at byte {self._offset + len(content)}, too early: it was cut off.")
        self._offset += num_bytes
        self._on_bytes(num_bytes)
        return content

    def _damaged(self, offset: int) -> BackupError:
        return BackupError(f"The archive is damaged at byte {offset}, or no backup of Multicap.")
