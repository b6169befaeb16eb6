"""Unpack untrusted zip archives of keypoint files, one a camera, within limits."""

import io
import stat
import zipfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path, PurePosixPath
from typing import TypeVar

from pipeline.capture.keypoint_files.folders import MAX_FILE_BYTES
from pipeline.errors import DISK_FULL, InputError, Problem

_BROKEN = "The file is not a zip archive, or it is damaged or encrypted."
_MAX_ENTRIES = 500_000
# Size of the directory of so many files with names of the usual length.
_MAX_DIRECTORY_BYTES = 96 * 2**20
_MAX_TOTAL_BYTES = 4 * 2**30

_Found = TypeVar("_Found")


def unpack_keypoints(archives: Sequence[Path], folder: Path) -> None:
    """Unpack each archive into a folder of the same name, for ``keypoints.open_keypoints``.

    The files of an archive lie at its top or in one folder. Folder names are dropped, and only JSON files are unpacked.

    Parameters
    ----------
    archives
        Archives named ``<camera>.zip``.
    folder
        Empty folder to unpack into.

    Raises
    ------
    InputError
        With the problems of all archives that are damaged, encrypted or too large, or that contain links or a name
        twice.
    """
    problems: list[Problem] = []
    # The directories of all archives first: reading them is cheap, unpacking is not.
    files = {archive: _attempt(archive, partial(_list_files, archive, folder), problems) for archive in archives}
    left_bytes = _MAX_TOTAL_BYTES
    if not problems:
        for archive, listed in files.items():
            unpack = partial(_unpack, archive, listed or (), folder / archive.stem, left_bytes)
            left_bytes -= _attempt(archive, unpack, problems) or 0
    if problems:
        raise InputError(problems)


class _RefusedError(Exception):
    """The archive is refused; the text is the message of its problem."""


class _BoundedReader(io.BufferedReader):
    """Reader that refuses to read a too large directory of an archive at once."""

    def read(self, size: int | None = -1) -> bytes:
        """Read some bytes."""
        if size is not None and size > _MAX_DIRECTORY_BYTES:
            raise _RefusedError(f"The archive's directory is larger than {_MAX_DIRECTORY_BYTES // 2**20} MiB.")
        return super().read(size)


def _attempt(archive: Path, step: Callable[[], _Found], problems: list[Problem]) -> _Found | None:
    """Run a step with an archive; add its problem if that fails, and return ``None``."""
    try:
        return step()
    except _RefusedError as refused:
        message = str(refused)
    except OSError as error:
        if error.errno in DISK_FULL:
            raise  # not a problem of the archive
        message = _BROKEN
    except MemoryError:
        raise
    # zipfile passes on all kinds of exceptions of the decompressors for a damaged archive.
    except Exception:
        message = _BROKEN
    hint = "Send one zip archive for each camera, with the JSON files of its frames."
    problems.append(Problem("keypoints_archive", message, file=archive.name, hint=hint))
    return None


def _list_files(archive: Path, folder: Path) -> Sequence[zipfile.ZipInfo]:
    """List the JSON files in the directory of an archive, check them, and make the target folder."""
    target = folder / archive.stem
    if archive.suffix.lower() != ".zip" or target.exists():
        raise _RefusedError("The archive must have the name of its camera with the ending .zip.")
    target.mkdir()
    with _BoundedReader(io.FileIO(archive)) as file, zipfile.ZipFile(file) as entries:
        files = [
            entry for entry in entries.infolist() if not entry.is_dir() and entry.filename.lower().endswith(".json")
        ]
    if len(files) > _MAX_ENTRIES:
        raise _RefusedError(f"The archive has {len(files)} files; at most {_MAX_ENTRIES} are allowed.")
    if len({str(PurePosixPath(entry.filename).parent) for entry in files}) > 1:
        raise _RefusedError("The archive has files in several folders; it must contain the files of one camera.")
    names = set()
    for entry in files:
        name = _name_of(entry)
        if stat.S_ISLNK(entry.external_attr >> 16):
            raise _RefusedError(f"{name} is a link.")
        if name in names:
            raise _RefusedError(f"The archive contains {name} twice.")
        if entry.file_size > MAX_FILE_BYTES:
            raise _too_large(name)
        names.add(name)
    return files


def _name_of(entry: zipfile.ZipInfo) -> str:
    """Name of an entry without its folders."""
    return PurePosixPath(entry.filename.replace("\\", "/")).name


def _unpack(archive: Path, files: Sequence[zipfile.ZipInfo], target: Path, left_bytes: int) -> int:
    """Unpack the files of an archive; return the number of bytes written."""
    total_bytes = 0
    with zipfile.ZipFile(archive) as entries:
        for entry in files:
            max_bytes = min(MAX_FILE_BYTES, left_bytes - total_bytes)
            total_bytes += _copy(entries, entry, target / _name_of(entry), max_bytes)
    return total_bytes


def _copy(entries: zipfile.ZipFile, entry: zipfile.ZipInfo, path: Path, max_bytes: int) -> int:
    """Write an entry to disk; the size in its header is not trusted."""
    with entries.open(entry) as source:
        content = source.read(max_bytes + 1)
    if len(content) > max_bytes:
        raise _too_large(path.name)
    path.write_bytes(content)
    return len(content)


def _too_large(name: str) -> _RefusedError:
    return _RefusedError(f"{name} is too large, or all archives together are too large when unpacked.")
