"""Unpack untrusted zip archives of keypoint files, one a camera, within limits."""

import sys
import zipfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TypeVar

from pipeline.capture.keypoint_files import forms
from pipeline.capture.keypoint_files.folders import MAX_FILE_BYTES
from pipeline.capture.keypoint_files.forms import TEXT, endings
from pipeline.capture.keypoint_files.readers import freemocap
from pipeline.core.errors import InputError, Problem, printable
from pipeline.core.problems.session_codes import KEYPOINTS_ARCHIVE
from pipeline.core.runtime.zips import ArchiveError, entry_name, list_entries, read_entry, refusal

_MAX_TOTAL_BYTES = 4 * 2**30
# FreeMoCap's array of all cameras: half an hour of four cameras at 30 Hz, with faces.
_MAX_ARRAY_BYTES = 1 * 2**30
_ARRAY = ".npy"

_Found = TypeVar("_Found")


def unpack_keypoints(archives: Sequence[Path], folder: Path) -> Path:
    """Unpack each archive into a folder of the same name; return the folder for ``keypoints.open_keypoints``.

    The files of an archive lie at its top or in one folder. Folder names are dropped, and only JSON, CSV, HDF5 and
    arrays are unpacked, or without these YOLO's texts. Archives are named ``<camera>.zip``, and ``folder`` is empty. A
    single archive may have FreeMoCap's array of all cameras, which may also be given as it is. Raises ``InputError``
    with the problems of all archives that are damaged, encrypted or too large, that contain links or a name twice, or
    that have only files of known kinds that are not read.
    """
    first, is_single = archives[0], len(archives) == 1
    if is_single and first.suffix.lower() == _ARRAY:
        (folder / first.stem).mkdir()
        (folder / first.stem / first.name).symlink_to(first.absolute())
        return folder / first.stem
    problems: list[Problem] = []
    max_bytes = _MAX_ARRAY_BYTES if is_single else MAX_FILE_BYTES
    # The directories of all archives first: reading them is cheap, unpacking is not.
    files = {
        archive: _attempt(archive, partial(_list_files, archive, folder, max_bytes), problems) for archive in archives
    }
    left_bytes = _MAX_TOTAL_BYTES
    if not problems:
        for archive, listed in files.items():
            unpack = partial(_unpack, archive, listed or (), folder / archive.stem, max_bytes, left_bytes)
            left_bytes -= _attempt(archive, unpack, problems) or 0
    if problems:
        raise InputError(problems)
    is_of_all = is_single and freemocap.file_of_cameras((folder / first.stem).iterdir()) is not None
    return folder / first.stem if is_of_all else folder


def _attempt(archive: Path, step: Callable[[], _Found], problems: list[Problem]) -> _Found | None:
    """Run a step with an archive; add its problem if that fails, and return ``None``."""
    try:
        return step()
    except Exception as error:
        refused = refusal(error)
        if not isinstance(refused, ArchiveError):
            raise
        message = str(refused)
    hint = (
        "Send one zip archive for each camera, with its keypoint files: JSON, CSV, HDF5, labels of YOLO, or an array "
        "(.npy); or FreeMoCap's array of all cameras."
    )
    problems.append(Problem(KEYPOINTS_ARCHIVE, message, file=archive.name, hint=hint))
    return None


def _list_files(archive: Path, folder: Path, max_bytes: int) -> Sequence[zipfile.ZipInfo]:
    """List the keypoint files in the directory of an archive, check them, and make the target folder."""
    target = folder / archive.stem
    if archive.suffix.lower() != ".zip" or target.exists():
        raise ArchiveError("The archive must have the name of its camera with the ending .zip.")
    target.mkdir()
    files = list_entries(archive, endings(), max_bytes) or list_entries(archive, {TEXT}, max_bytes)
    if not files:
        others = list_entries(archive, forms.ENDINGS, sys.maxsize)
        if known := forms.described(entry_name(entry) for entry in others):
            raise ArchiveError(printable(" ".join(known)))
    return files


def _unpack(archive: Path, files: Sequence[zipfile.ZipInfo], target: Path, max_bytes: int, left_bytes: int) -> int:
    """Unpack the files of an archive; return the number of bytes written."""
    total_bytes = 0
    with zipfile.ZipFile(archive) as entries:
        for entry in files:
            content = read_entry(entries, entry, min(max_bytes, left_bytes - total_bytes))
            (target / entry_name(entry)).write_bytes(content)
            total_bytes += len(content)
    return total_bytes
