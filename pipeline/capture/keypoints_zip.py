"""Unpack a stranger's archives of keypoint files, a zip a camera, within limits."""

import io
import stat
import zipfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path, PurePosixPath
from typing import TypeVar

from pipeline.errors import DISK_FULL, InputError, Problem

_BROKEN = "This is no zip archive, or it is broken or encrypted."
_MAX_ENTRIES = 500_000
# Of that many files with names of the usual length.
_MAX_DIRECTORY_BYTES = 96 * 2**20
_MAX_FILE_BYTES = 4 * 2**20
_MAX_TOTAL_BYTES = 4 * 2**30

_Found = TypeVar("_Found")


def unpack_keypoints(archives: Sequence[Path], folder: Path) -> None:
    """Unpack each archive into a folder of its name, as ``keypoints.open_keypoints`` takes them.

    The files of an archive lie at its top, or in one folder; only their names count, and what is no JSON is left out.

    Parameters
    ----------
    archives
        ``<camera>.zip`` each.
    folder
        Empty.

    Raises
    ------
    InputError
        With all archives that are none, hold too much, hold links or one name twice, or are encrypted or broken.
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
    """Why an archive is not taken, in words for a person."""


class _BoundedReader(io.BufferedReader):
    """A file that refuses to read an archive's directory at once where that is too large."""

    def read(self, size: int | None = -1) -> bytes:
        """Read some bytes."""
        if size is not None and size > _MAX_DIRECTORY_BYTES:
            raise _RefusedError(f"The archive's directory is larger than {_MAX_DIRECTORY_BYTES // 2**20} MiB.")
        return super().read(size)


def _attempt(archive: Path, step: Callable[[], _Found], problems: list[Problem]) -> _Found | None:
    """Take a step with an archive; what is wrong with the archive is added to the problems."""
    try:
        return step()
    except _RefusedError as refused:
        message = str(refused)
    except OSError as error:
        if error.errno in DISK_FULL:
            raise  # the archive is not to blame
        message = _BROKEN
    except MemoryError:
        raise
    # zipfile passes on whatever the decompressors and Python raise of a damaged archive.
    except Exception:
        message = _BROKEN
    hint = "Send a zip archive a camera, with the JSON files of its frames."
    problems.append(Problem("keypoints_archive", message, file=archive.name, hint=hint))
    return None


def _list_files(archive: Path, folder: Path) -> Sequence[zipfile.ZipInfo]:
    """List the JSON files of an archive by its directory, and make the folder that they go to."""
    target = folder / archive.stem
    if archive.suffix.lower() != ".zip" or target.exists():
        raise _RefusedError("The archive of a camera is named as the camera, with .zip behind.")
    target.mkdir()
    with _BoundedReader(io.FileIO(archive)) as file, zipfile.ZipFile(file) as entries:
        found = [one for one in entries.infolist() if not one.is_dir() and one.filename.lower().endswith(".json")]
    if len(found) > _MAX_ENTRIES:
        raise _RefusedError(f"The archive holds {len(found)} files; at most {_MAX_ENTRIES} are taken.")
    if len({str(PurePosixPath(one.filename).parent) for one in found}) > 1:
        raise _RefusedError("The archive holds files of several folders; it must be of one camera.")
    names = set()
    for entry in found:
        name = _name_of(entry)
        if stat.S_ISLNK(entry.external_attr >> 16):
            raise _RefusedError(f"{name} is a link.")
        if name in names:
            raise _RefusedError(f"The archive holds {name} twice.")
        if entry.file_size > _MAX_FILE_BYTES:
            raise _too_large(name)
        names.add(name)
    return found


def _name_of(entry: zipfile.ZipInfo) -> str:
    """Name of a file, never a path: what stands before the last slash is dropped."""
    return PurePosixPath(entry.filename.replace("\\", "/")).name


def _unpack(archive: Path, files: Sequence[zipfile.ZipInfo], target: Path, left_bytes: int) -> int:
    """Unpack the files of one archive and return how many bytes came out."""
    total_bytes = 0
    with zipfile.ZipFile(archive) as entries:
        for entry in files:
            max_bytes = min(_MAX_FILE_BYTES, left_bytes - total_bytes)
            total_bytes += _copy(entries, entry, target / _name_of(entry), max_bytes)
    return total_bytes


def _copy(entries: zipfile.ZipFile, entry: zipfile.ZipInfo, path: Path, max_bytes: int) -> int:
    """Write an entry to disk; what its header says of its size is not believed."""
    with entries.open(entry) as source:
        content = source.read(max_bytes + 1)
    if len(content) > max_bytes:
        raise _too_large(path.name)
    path.write_bytes(content)
    return len(content)


def _too_large(name: str) -> _RefusedError:
    return _RefusedError(f"{name} is too large, or the archives are, once unpacked.")
