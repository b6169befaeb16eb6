"""Untrusted zip archives: directories are listed and entries read within limits; nothing is unpacked."""

import io
import stat
import zipfile
from collections.abc import Collection, Sequence
from pathlib import Path, PurePosixPath

from pipeline.core.errors import DISK_FULL, printable

MAX_ENTRIES = 500_000
# Size of the directory of so many files with names of the usual length.
MAX_DIRECTORY_BYTES = 96 * 2**20
_BROKEN = "The file is not a zip archive, or it is damaged or encrypted."


class ArchiveError(Exception):
    """The archive is refused; the text is the message for the user."""


class _BoundedReader(io.BufferedReader):
    """Reader that refuses to read a too large directory of an archive at once."""

    def read(self, size: int | None = -1) -> bytes:
        """Read some bytes."""
        if size is not None and size > MAX_DIRECTORY_BYTES:
            raise ArchiveError(f"The archive's directory is larger than {MAX_DIRECTORY_BYTES // 2**20} MiB.")
        return super().read(size)


def list_entries(archive: Path, endings: Collection[str], max_file_bytes: int) -> Sequence[zipfile.ZipInfo]:
    """List the files of some endings in the directory of an archive; they lie at its top or in one folder.

    ``endings``: endings in lower case with their points; other files are ignored. ``max_file_bytes``: largest size that
    the directory may state of a file. Raises ``ArchiveError`` if the archive is damaged, encrypted or too large, or
    contains links, several folders, or a name twice.
    """
    try:
        with _BoundedReader(io.FileIO(archive)) as file, zipfile.ZipFile(file) as entries:
            files = [
                entry
                for entry in entries.infolist()
                if not entry.is_dir()
                and PurePosixPath(entry.filename.lower()).suffix in endings
                # macOS puts attributes of each file beside it.
                and not entry_name(entry).startswith("._")
            ]
    except Exception as error:
        raise refusal(error) from None
    if len(files) > MAX_ENTRIES:
        raise ArchiveError(f"The archive has {len(files)} files; at most {MAX_ENTRIES} are allowed.")
    if len({str(PurePosixPath(entry.filename).parent) for entry in files}) > 1:
        raise ArchiveError("The archive has files in several folders; it must contain the files of one camera.")
    names = set()
    for entry in files:
        name = entry_name(entry)
        if stat.S_ISLNK(entry.external_attr >> 16):
            raise ArchiveError(f"{name} is a link.")
        if name in names:
            raise ArchiveError(f"The archive contains {name} twice.")
        if entry.file_size > max_file_bytes:
            raise entry_too_large(name)
        names.add(name)
    return files


def entry_name(entry: zipfile.ZipInfo) -> str:
    """Name of an entry without its folders."""
    return PurePosixPath(entry.filename.replace("\\", "/")).name


def read_entry(entries: zipfile.ZipFile, entry: zipfile.ZipInfo, max_bytes: int) -> bytes:
    """Read an entry; the size that the directory states is not trusted.

    Raises ``ArchiveError`` if the entry is damaged, encrypted, or larger than ``max_bytes``.
    """
    try:
        with entries.open(entry) as source:
            content = source.read(max_bytes + 1)
    except Exception as error:
        raise refusal(error) from None
    if len(content) > max_bytes:
        raise entry_too_large(entry_name(entry))
    return content


def refusal(error: Exception) -> Exception:
    """Error to raise for one of ``zipfile``: decompressors pass on all kinds of exceptions for a damaged archive."""
    if isinstance(error, ArchiveError | MemoryError) or (isinstance(error, OSError) and error.errno in DISK_FULL):
        return error
    return ArchiveError(_BROKEN)


def entry_too_large(name: str) -> ArchiveError:
    """Error of an entry that is too large."""
    return ArchiveError(f"{printable(name)} is too large, or all archives together are too large when unpacked.")
