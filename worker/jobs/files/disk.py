"""The disk: what survives a loss of power, how much room is left, and a reserve for deleting.

Two amounts are kept free. Nothing new is taken in, and no chunk is begun, where less than the *headroom* is left: the
database, logs and work under way live on it. The *reserve* is a file that holds room for the moment when other programs
have filled the disk: whoever deletes something gives it up, for the database needs room even to forget a row.
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
_MAX_HEADROOM_BYTES = 256 * _MIB
_MAX_RESERVE_BYTES = 32 * _MIB

_DISK_FULL = frozenset({errno.ENOSPC, errno.EDQUOT})
# The second is of the write-ahead log's index, which SQLite keeps in a file that it maps; the third of a user's quota.
_SQLITE_FULL = frozenset({sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR_SHMSIZE, sqlite3.SQLITE_IOERR_WRITE})
_POSTGRES_FULL = "53100"

_Result = TypeVar("_Result")


def sync(path: Path) -> None:
    """Have a file's content, or a folder's list of files, on disk before this returns."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def is_disk_full(error: BaseException) -> bool:
    """Whether an error of the file system or of the database says that a disk is full."""
    if isinstance(error, DBAPIError) and error.orig is not None:
        return is_disk_full(error.orig)
    if isinstance(error, OSError):
        return error.errno in _DISK_FULL
    return (
        getattr(error, "sqlite_errorcode", None) in _SQLITE_FULL or getattr(error, "sqlstate", None) == _POSTGRES_FULL
    )


class DiskSpace:
    """Room on the file system of a folder.

    Parameters
    ----------
    folder
        The data folder; made when it is needed.
    headroom_bytes
        How much is kept free; ``None``: 5 % of the file system, at most 256 MiB.
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

    def has_room(self, num_bytes: int = 0) -> bool:
        """Whether the headroom is free still once so many bytes are written."""
        return self.free_bytes >= self.headroom_bytes + num_bytes

    def require_room(self, num_bytes: int = 0) -> None:
        """Raise ``OSError`` (ENOSPC) unless ``has_room``."""
        if not self.has_room(num_bytes):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def set_aside(self) -> None:
        """Make the reserve, or enlarge it: of a full size where there is room, else of half of what is left."""
        status = os.statvfs(self._folder)
        wanted = min(_MAX_RESERVE_BYTES, status.f_blocks * status.f_frsize // 50)
        held = self._reserve.stat().st_size if self._reserve.exists() else 0
        free = held + self.free_bytes
        num_bytes = wanted if free >= wanted + self.headroom_bytes else min(wanted, free // 2)
        if num_bytes <= held:
            return
        with contextlib.suppress(OSError), self._reserve.open("ab") as file:  # others may have been faster
            os.posix_fallocate(file.fileno(), 0, num_bytes)

    def give_up(self) -> None:
        """Give the reserve to whoever writes next."""
        with contextlib.suppress(OSError):
            self._reserve.unlink(missing_ok=True)

    def using_reserve(self, act: Callable[[], _Result]) -> _Result:
        """Do what must work on a full disk, at the reserve's expense: delete or end something, open the database.

        Parameters
        ----------
        act
            Is run a second time if the disk is full.
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
