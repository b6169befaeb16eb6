"""Cache of files of a distant artifact store, shared by the processes of this machine."""

import contextlib
import fcntl
import hashlib
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO
from uuid import uuid4

from filelock import FileLock

# Suffixes of a copy, of its lock, of an incomplete copy, and of an empty file whose time is the last use of the copy.
# The times of the copy itself tell whether its content has changed.
_COPY, _LOCK, _PART, _USED = ".copy", ".lock", ".part", ".used"


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
