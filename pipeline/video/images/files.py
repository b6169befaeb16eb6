"""Files of a sequence of images, in a folder or in a zip archive: listed and numbered, and read one at a time."""

import hashlib
import re
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol, TypeVar

from pipeline.core.errors import UnusableError
from pipeline.core.problems.session_codes import IMAGES_ARCHIVE, NO_IMAGES
from pipeline.core.runtime.zips import ArchiveError, entry_name, list_entries, read_entry

SEQUENCE = "images"
"""Name in place of a codec of a sequence of images."""

ENDINGS = frozenset({".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff"})
MAX_IMAGE_BYTES = 2**28
_MAX_IMAGES = 500_000
# Numbers that lie farther apart are times or dates, and not numbers of frames.
_MAX_SPARSE = 10
_DIGITS = re.compile(r"(\d{1,15})\D*$")
_File = TypeVar("_File")
_HINT = "Send one zip archive for each camera, with the images of its frames (JPEG, PNG, BMP or TIFF)."


class ImageFiles(Protocol):
    """Opened sequence."""

    @property
    def frames(self) -> Sequence[int]:
        """Numbers of the frames, ascending from 0; a number that is left out is a dropped frame."""

    def read(self, frame: int) -> bytes:
        """Content of the image of a frame; raises ``ArchiveError`` or ``OSError``."""


def is_sequence(path: Path) -> bool:
    """Return whether a path may be a sequence of images: a folder, or a file that begins like a zip archive."""
    if path.is_dir():
        return True
    with path.open("rb") as file:
        return file.read(4) in {b"PK\x03\x04", b"PK\x05\x06"}


@contextmanager
def open_images(path: Path) -> Iterator[ImageFiles]:
    """Open a sequence of images. Raises ``UnusableError`` if there are no images, or the archive is refused."""
    if path.is_dir():
        yield _Folder(path)
        return
    try:
        entries = list_entries(path, ENDINGS, MAX_IMAGE_BYTES)
    except ArchiveError as error:
        raise UnusableError(IMAGES_ARCHIVE, str(error), _HINT) from None
    with zipfile.ZipFile(path) as archive:
        yield _Archive(archive, {entry_name(entry): entry for entry in entries})


def folder_sha256(folder: Path) -> str:
    """SHA-256 of the names and contents of a folder's images, in hexadecimal digits."""
    digest = hashlib.sha256()
    for name, path in sorted(_images_in(folder).items()):
        with path.open("rb") as file:
            digest.update(f"{len(name)} {name} {hashlib.file_digest(file, 'sha256').hexdigest()}\n".encode())
    return digest.hexdigest()


def _images_in(folder: Path) -> dict[str, Path]:
    files = (path for path in folder.iterdir() if path.suffix.lower() in ENDINGS and not path.name.startswith("."))
    return {path.name: path for path in files if path.is_file()}


class _Folder:
    def __init__(self, path: Path) -> None:
        self._files = _numbered(_images_in(path))

    @property
    def frames(self) -> Sequence[int]:
        return list(self._files)

    def read(self, frame: int) -> bytes:
        with self._files[frame].open("rb") as file:
            content = file.read(MAX_IMAGE_BYTES + 1)
        if len(content) > MAX_IMAGE_BYTES:
            raise ArchiveError("The image is too large.")
        return content


class _Archive:
    def __init__(self, archive: zipfile.ZipFile, entries: Mapping[str, zipfile.ZipInfo]) -> None:
        self._archive, self._entries = archive, _numbered(entries)

    @property
    def frames(self) -> Sequence[int]:
        return list(self._entries)

    def read(self, frame: int) -> bytes:
        return read_entry(self._archive, self._entries[frame], MAX_IMAGE_BYTES)


def _numbered(files: Mapping[str, _File]) -> dict[int, _File]:
    """Files by the number of their frame: the last digits of each name, or their place in sorted order.

    The order counts if a name has no digits, if two have the same number, or if the numbers are too far apart.
    """
    if not files:
        message = "There are no images in it."
        raise UnusableError(NO_IMAGES, message, _HINT)
    if len(files) > _MAX_IMAGES:
        message = f"There are {len(files)} images; at most {_MAX_IMAGES} are allowed."
        raise UnusableError(IMAGES_ARCHIVE, message, "Cut it into several.")
    numbers = {name: int(match[1]) for name in files if (match := _DIGITS.search(Path(name).stem))}
    first, last = min(numbers.values(), default=0), max(numbers.values(), default=0)
    if len(set(numbers.values())) < len(files) or last - first >= _MAX_SPARSE * len(files):
        return dict(enumerate(files[name] for name in sorted(files)))
    return {numbers[name] - first: files[name] for name in sorted(files, key=lambda name: numbers[name])}
