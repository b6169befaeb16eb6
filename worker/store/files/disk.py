"""Disk of the data folder: its mode, syncing of files, free space, and a reserve for deletions.

Two amounts are kept free. With less than the *headroom* left, nothing new is accepted and no chunk is begun: the
database, logs and work under way need it. The *reserve* is a file that keeps room for the case that other programs have
filled the disk: a deletion releases it, because the database needs room even to delete a row.
"""

import contextlib
import errno
import os
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from sqlalchemy.exc import DBAPIError

_MIB = 2**20
_RESERVE_NAME = "reserve"
# Inodes that are kept free for work under way: a twentieth, and at most so many.
_MAX_INODE_HEADROOM = 1000
_MAX_HEADROOM_BYTES = 256 * _MIB
_MAX_RESERVE_BYTES = 32 * _MIB

_DISK_FULL = frozenset({errno.ENOSPC, errno.EDQUOT})
# The second is an error of the write-ahead log's index, a mapped file; the third one of a user's quota.
_SQLITE_FULL = frozenset({sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR_SHMSIZE, sqlite3.SQLITE_IOERR_WRITE})
_POSTGRES_FULL = "53100"

_Result = TypeVar("_Result")


_OWNER_ONLY = 0o077
_MODE = 0o700
_OURS = ("multicap.db", "artifacts", "serve.lock")


def sync(path: Path) -> None:
    """Write a file's content, or a folder's list of files, to the disk before returning."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def is_disk_full(error: BaseException) -> bool:
    """True if an error of the file system or of the database says that a disk is full."""
    if isinstance(error, DBAPIError) and error.orig is not None:
        return is_disk_full(error.orig)
    if isinstance(error, OSError):
        return error.errno in _DISK_FULL
    return (
        getattr(error, "sqlite_errorcode", None) in _SQLITE_FULL or getattr(error, "sqlstate", None) == _POSTGRES_FULL
    )


def append_whole(path: Path, content: bytes) -> None:
    """Append to a file; if that fails, as on a full disk, the file stays as it was."""
    # Without a buffer, whose rest would be written once more when the file is closed.
    with path.open("ab", buffering=0) as file:
        num_bytes, left = file.tell(), memoryview(content)
        try:
            while left:
                left = left[file.write(left) :]
        except OSError:
            file.truncate(num_bytes)
            raise


class DiskSpace:
    """Free space on the file system of a folder.

    The data folder is made when it is needed. ``headroom_bytes`` are kept free; ``None``: 5 % of the file system, at
    most 256 MiB.
    """

    def __init__(self, folder: Path, headroom_bytes: int | None = None) -> None:
        self._folder = folder
        self._headroom_bytes = headroom_bytes
        self._reserve = folder / _RESERVE_NAME

    @property
    def free_bytes(self) -> int:
        """Bytes that can be written now."""
        status = os.statvfs(self._folder)
        return status.f_bavail * status.f_frsize

    @property
    def headroom_bytes(self) -> int:
        """Bytes that are kept free."""
        if self._headroom_bytes is not None:
            return self._headroom_bytes
        status = os.statvfs(self._folder)
        return min(_MAX_HEADROOM_BYTES, status.f_blocks * status.f_frsize // 20)

    @property
    def has_inodes(self) -> bool:
        """True if new files can be made; file systems without a fixed number of inodes state 0 of 0."""
        status = os.statvfs(self._folder)
        return status.f_favail >= min(_MAX_INODE_HEADROOM, status.f_files // 20)

    def has_room(self, num_bytes: int = 0) -> bool:
        """True if files can be made, and the headroom stays free after so many bytes are written."""
        return self.has_inodes and self.free_bytes >= self.headroom_bytes + num_bytes

    def require_room(self, num_bytes: int = 0) -> None:
        """Raise ``OSError`` (ENOSPC) unless ``has_room``."""
        if not self.has_room(num_bytes):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def set_aside(self) -> None:
        """Make the reserve, or enlarge it: to its full size if there is room, else to half of what is left."""
        status = os.statvfs(self._folder)
        wanted = min(_MAX_RESERVE_BYTES, status.f_blocks * status.f_frsize // 50)
        held = self._reserve.stat().st_size if self._reserve.exists() else 0
        free = held + self.free_bytes
        num_bytes = wanted if free >= wanted + self.headroom_bytes else min(wanted, free // 2)
        if num_bytes <= held:
            return
        with contextlib.suppress(OSError), self._reserve.open("ab") as file:  # other processes may do the same
            os.posix_fallocate(file.fileno(), 0, num_bytes)

    def give_up(self) -> None:
        """Remove the reserve, so that its room can be used."""
        with contextlib.suppress(OSError):
            self._reserve.unlink(missing_ok=True)

    def using_reserve(self, act: Callable[[], _Result]) -> _Result:
        """Run something that must work on a full disk, such as a deletion; release the reserve if it is needed.

        ``act`` is run a second time if the disk is full.
        """
        try:
            return act()
        except Exception as error:
            if not is_disk_full(error):
                raise
        self.give_up()
        try:
            return act()
        finally:
            self.set_aside()


def keep_files_private() -> None:
    """Make new files of this process and its children readable by their owner only."""
    os.umask(_OWNER_ONLY)


def make_private(folder: Path) -> None:
    """Make the data folder if it is missing, and close it to other users.

    A folder with other files stays as it is: it was named by mistake. So does a folder of another owner, such as a
    volume of containers.
    """
    folder.mkdir(mode=_MODE, parents=True, exist_ok=True)
    with contextlib.suppress(PermissionError):
        if not any(folder.iterdir()) or any((folder / name).exists() for name in _OURS):
            folder.chmod(_MODE)
