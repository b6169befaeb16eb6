"""Unpack a stranger's archives of keypoint files, a zip a camera, within limits."""

import stat
import zipfile
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from pipeline.errors import DISK_FULL, InputError, Problem

_BROKEN = "This is no zip archive, or it is broken or encrypted."
_MAX_ENTRIES = 500_000
_MAX_FILE_BYTES = 4 * 2**20
_MAX_TOTAL_BYTES = 4 * 2**30


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
    left_bytes = _MAX_TOTAL_BYTES
    for archive in archives:
        target = folder / archive.stem
        try:
            left_bytes -= _unpack(archive, target, left_bytes)
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
        else:
            continue
        hint = "Send a zip archive a camera, with the JSON files of its frames."
        problems.append(Problem("keypoints_archive", message, file=archive.name, hint=hint))
    if problems:
        raise InputError(problems)


class _RefusedError(Exception):
    """Why an archive is not taken, in words for a person."""


def _unpack(archive: Path, target: Path, left_bytes: int) -> int:
    """Unpack one archive and return how many bytes came out."""
    if archive.suffix.lower() != ".zip" or target.exists():
        raise _RefusedError("The archive of a camera is named as the camera, with .zip behind.")
    target.mkdir()
    total_bytes = 0
    with zipfile.ZipFile(archive) as entries:
        found = [one for one in entries.infolist() if not one.is_dir() and one.filename.lower().endswith(".json")]
        if len(found) > _MAX_ENTRIES:
            raise _RefusedError(f"The archive holds {len(found)} files; at most {_MAX_ENTRIES} are taken.")
        if len({str(PurePosixPath(one.filename).parent) for one in found}) > 1:
            raise _RefusedError("The archive holds files of several folders; it must be of one camera.")
        for entry in found:
            # A name, never a path: what stands before the last slash is dropped.
            path = target / PurePosixPath(entry.filename.replace("\\", "/")).name
            if stat.S_ISLNK(entry.external_attr >> 16):
                raise _RefusedError(f"{path.name} is a link.")
            if path.exists():
                raise _RefusedError(f"The archive holds {path.name} twice.")
            total_bytes += _copy(entries, entry, path, min(_MAX_FILE_BYTES, left_bytes - total_bytes))
    return total_bytes


def _copy(entries: zipfile.ZipFile, entry: zipfile.ZipInfo, path: Path, max_bytes: int) -> int:
    """Write an entry to disk; what its header says of its size is not believed."""
    with entries.open(entry) as source:
        content = source.read(max_bytes + 1)
    if len(content) > max_bytes:
        raise _RefusedError(f"{path.name} is too large, or the archives are, once unpacked.")
    path.write_bytes(content)
    return len(content)
