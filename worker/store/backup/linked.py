"""Hard links to files of a data folder, so that files that are deleted during a backup can still be copied."""

import contextlib
import fcntl
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from worker.store.backup.archive import BackupUsageError

# In the data folder, on the file system of artifacts and uploads.
_FOLDER = ".backup"


@dataclass(frozen=True, slots=True)
class HeldFile:
    """A held file: its content stays at ``path``. An upload may grow beyond ``num_bytes``."""

    path: Path
    num_bytes: int


class HeldFiles:
    """Hard links to files of a data folder."""

    def __init__(self, data_dir: Path, folder: Path) -> None:
        self._data_dir, self._folder = data_dir, folder
        self._held: dict[str, HeldFile] = {}

    def hold(self, path: str) -> HeldFile | None:
        """Hold a file, by its path below the data folder; ``None`` if it is missing."""
        if path not in self._held:
            source, link = self._data_dir / path, self._folder / str(len(self._held))
            try:
                os.link(source, link)
            except FileNotFoundError:
                return None
            except OSError:  # another file system, one without links, or a full one
                link = source
            try:
                self._held[path] = HeldFile(link, link.stat().st_size)
            except OSError:
                return None
        return self._held[path]


@contextlib.contextmanager
def held_files(data_dir: Path) -> Iterator[HeldFiles]:
    """Folder of links, removed at the end of the block; ``BackupUsageError`` if another backup is being made."""
    folder = data_dir / _FOLDER
    folder.mkdir(mode=0o700, exist_ok=True)
    with _locked(folder) as is_ours:
        if not is_ours:
            raise BackupUsageError(f"Another backup of {data_dir} is being made. Wait for its end.")
        _empty(folder)
        try:
            yield HeldFiles(data_dir, folder)
        finally:
            _empty(folder)


def release_abandoned(data_dir: Path) -> None:
    """Remove the links of a killed backup: they keep deleted files on the disk."""
    folder = data_dir / _FOLDER
    folder.mkdir(mode=0o700, exist_ok=True)  # made now, because it can't be on a full disk
    with _locked(folder) as is_ours:
        if is_ours:
            _empty(folder)


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[bool]:
    """Lock a folder, and yield whether that was possible. The lock ends with the process."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
        else:
            yield True
    finally:
        os.close(handle)


def _empty(folder: Path) -> None:
    for entry in os.scandir(folder):
        if entry.is_dir(follow_symlinks=False):
            shutil.rmtree(entry.path)
        else:
            Path(entry.path).unlink()
