"""Forms of sessions, calibrations and characters: their parts with names and size limits.

A part above its limit is refused at once. All other problems with names and parts are collected while the rest is read,
so that one response lists all of them.
"""

import contextlib
import hashlib
import json
import unicodedata
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from io import BufferedWriter
from pathlib import Path, PurePosixPath
from typing import BinaryIO, Literal

from api.web.errors import ApiError, ErrorItem, pointer_to
from api.web.http.bodies import form_kinds
from api.web.http.bodies.validation import FieldPlaces
from pipeline.capture.parts import group_parts
from pipeline.core.problems import request_codes
from pipeline.core.problems.code_group import Code

_MAX_NAME_BYTES = 200
_MAX_SHOWN = 100
# Limit on the parts beside the videos and one for each camera: errors of any number of wrong parts would fill memory.
_MAX_OTHER_PARTS = 32
# Limit on the videos of a camera: recordings come in parts, of which each camera has as many.
_MAX_PARTS_OF_CAMERA = 16
_BLOCK_BYTES = 2**20
_TOO_MANY = {
    form_kinds.VIDEOS: request_codes.TOO_MANY_VIDEOS,
    form_kinds.IMAGES: request_codes.TOO_MANY_IMAGES,
    form_kinds.KEYPOINTS: request_codes.TOO_MANY_KEYPOINTS,
    form_kinds.POINTS: request_codes.TOO_MANY_KEYPOINTS,
}
_TOO_LARGE = {
    "file": request_codes.FILE_TOO_LARGE,
    "part": request_codes.PART_TOO_LARGE,
    "piece": request_codes.PIECE_TOO_LARGE,
    "session": request_codes.SESSION_TOO_LARGE,
}


@dataclass(frozen=True, slots=True)
class FormLimits:
    """Size limits of a form and of its parts."""

    max_file_bytes: int
    max_keypoints_bytes: int
    max_session_bytes: int
    max_calibration_bytes: int
    max_character_bytes: int
    max_json_bytes: int
    max_cameras: int

    def max_files(self, part: str) -> int:
        """Largest number of files of a part that has files of all cameras."""
        return self.max_cameras * (_MAX_PARTS_OF_CAMERA if part == form_kinds.VIDEOS else 1)


@dataclass(frozen=True, slots=True)
class ReceivedFile:
    """Complete file of a form, on disk under its own name."""

    name: str
    path: Path
    num_bytes: int
    sha256: str


@dataclass(frozen=True, slots=True)
class Form:
    """Received form.

    ``files``: files of each part, by the part's name. ``documents``: JSON parts by name, unparsed. ``errors``:
    everything that is wrong with names and parts; files with errors are not in ``files``.
    """

    files: Mapping[str, tuple[ReceivedFile, ...]]
    documents: Mapping[str, bytes]
    errors: tuple[ErrorItem, ...]

    @property
    def videos(self) -> tuple[ReceivedFile, ...]:
        """Videos, one for each camera."""
        return self.files.get(form_kinds.VIDEOS, ())

    @property
    def keypoints(self) -> tuple[ReceivedFile, ...]:
        """Archives of keypoints, one for each camera."""
        return self.files.get(form_kinds.KEYPOINTS, ())

    @property
    def points(self) -> tuple[ReceivedFile, ...]:
        """Files of 3D points."""
        return self.files.get(form_kinds.POINTS, ())

    def pointers(self) -> dict[str, ReceivedFile]:
        """Files by their JSON pointers."""
        return {
            f"/{part}/{index}" if part in form_kinds.VIEWS else f"/{part}": file
            for part, files in self.files.items()
            for index, file in enumerate(files)
        }


@dataclass(slots=True)
class _OpenFile:
    """File that is being received."""

    name: str
    file: BufferedWriter
    num_bytes: int = 0
    digest: "hashlib._Hash" = field(default_factory=hashlib.sha256)

    def write(self, data: bytes) -> None:
        self.file.write(data)
        self.digest.update(data)
        self.num_bytes += len(data)

    def close(self) -> ReceivedFile:
        self.file.close()
        return ReceivedFile(self.name, Path(self.file.name), self.num_bytes, self.digest.hexdigest())


class Parts:
    """Receiver of the parts of a form: files go to disk, JSON to memory; refused parts are dropped."""

    def __init__(self, folder: Path, limits: FormLimits, kind: form_kinds.FormKind, places: FieldPlaces) -> None:
        self._folder = folder
        self._limits = limits
        self._kind = kind
        self._places = places
        limit_of = {
            form_kinds.VIDEOS: limits.max_file_bytes,
            form_kinds.IMAGES: limits.max_file_bytes,
            form_kinds.CHARACTER: limits.max_character_bytes,
        }
        limit_of |= dict.fromkeys(
            (form_kinds.KEYPOINTS, form_kinds.POINTS, form_kinds.LABORATORY), limits.max_keypoints_bytes
        )
        self._max_file_bytes = {part: limit_of.get(part, limits.max_calibration_bytes) for part in kind.parts}
        self._files: dict[str, list[ReceivedFile]] = {part: [] for part in self._max_file_bytes}
        self._counts = dict.fromkeys(self._max_file_bytes, 0)
        self._names: set[str] = set()
        self._videos: list[str] = []
        self._documents: dict[str, bytearray] = {}
        self._errors: list[ErrorItem] = []
        self._refused = False
        self._num_other_parts = 0
        self._total_bytes = 0
        self._open: _OpenFile | None = None
        self._write: Callable[[bytes], None] = _discard
        self._part, self._file_name, self._max_bytes, self._part_bytes = "", "", 0, 0

    def begin(self, part: str, file_name: str | None) -> None:
        """Begin a part."""
        self._num_other_parts += part != form_kinds.VIDEOS or self._counts[part] >= self._limits.max_files(part)
        if self._num_other_parts > self._limits.max_cameras + _MAX_OTHER_PARTS:
            raise ApiError(request_codes.TOO_MANY_PARTS, "The form has too many parts.")
        self._part, self._file_name, self._part_bytes = part, file_name or "", 0
        # A refused part is read to its end: the response states why it is refused, not that it is large.
        self._max_bytes = self._limits.max_session_bytes
        self._write = _discard
        if part in self._files:
            self._max_bytes = self._max_file_bytes[part]
            if self._admit(part, self._file_name):
                self._open = _OpenFile(self._file_name, (self._folder / self._file_name).open("xb"))
                self._write = self._open.write
        elif part in self._kind.documents and part not in self._documents:
            self._max_bytes = self._limits.max_json_bytes
            self._write = self._documents.setdefault(part, bytearray()).extend
        elif part in self._documents:
            self._add_error(request_codes.DUPLICATE_PART, "The form has this part more than once.", f"/{part}")
        else:
            known = ", ".join([*self._files, *self._kind.documents])
            message, name = f"The form has a part that is not one of: {known}.", part[:_MAX_SHOWN]
            hint = self._places.hint(name, "")
            self._add_error(request_codes.UNKNOWN_PART, message, pointer_to(name), hint=hint)

    def write(self, data: bytes) -> None:
        """Receive the next bytes of the part."""
        self._count_bytes(len(data))
        self._write(data)

    def _count_bytes(self, num_bytes: int) -> None:
        self._part_bytes += num_bytes
        self._total_bytes += num_bytes
        if self._part_bytes > self._max_bytes:
            raise too_large("part", self._max_bytes, self._part, self._file_name)
        if self._total_bytes > self._limits.max_session_bytes:
            raise too_large("session", self._limits.max_session_bytes)

    def end(self) -> None:
        """End the part."""
        if self._open is not None:
            self._files[self._part].append(self._open.close())
            self._open = None

    def adopt(self, part: str, name: str, source: Path) -> None:
        """Add a file that is on disk already, by a hard link in the folder; ``source`` stays."""
        self._part, self._file_name, self._part_bytes = part, name, 0
        self._max_bytes = self._max_file_bytes[part]
        num_bytes = source.stat().st_size
        self._count_bytes(num_bytes)
        if self._admit(part, name):
            path = self._folder / name
            path.hardlink_to(source)
            with path.open("rb") as file:
                sha256 = hashlib.file_digest(file, "sha256").hexdigest()
            self._files[part].append(ReceivedFile(name, path, num_bytes, sha256))

    def copy(self, part: str, name: str, source: BinaryIO) -> None:
        """Add a copy of an open file."""
        self.begin(part, name)
        try:
            while block := source.read(_BLOCK_BYTES):
                self.write(block)
            self.end()
        finally:
            self.close()

    def has(self, part: str) -> bool:
        """True if the client sent a file of a part, even a refused one."""
        return self._counts[part] > 0

    def reject_field(self, field: str, code: Code, message: str, hint: str) -> None:
        """Record an error about a field that stands for files, which are not reported as missing then."""
        self._add_error(code, message, pointer_to(field), hint=hint)
        self._refused = True

    def lack(self, part: str, code: Code, message: str, hint: str, file: str | None = None) -> None:
        """Record an error about a missing or unusable file of a part."""
        self._add_error(code, message, self._next_pointer(part), file, hint)

    def form(self, documents: Iterable[str] = (), num_stated_parts: int = 0) -> Form:
        """Return all parts, for the end of the body.

        ``documents`` are names of further documents that were sent, in which so many videos are stated to be further
        parts of a recording.
        """
        num_stated_parts += _num_stated_parts(self._documents.get(form_kinds.MANIFEST, b""))
        recordings = group_parts(PurePosixPath(name).stem for name in self._videos)
        if len(recordings) - num_stated_parts > (most := self._limits.max_cameras):
            message = f"A {self._kind.noun} has {most} cameras at most; these are {len(recordings)} recordings."
            self._add_error(request_codes.TOO_MANY_VIDEOS, message, f"/{form_kinds.VIDEOS}/{most}")
        sent = dict.fromkeys((*self._documents, *documents), 1) | {name: n for name, n in self._counts.items() if n}
        for code, message, part in self._kind.faults(Counter(sent)):
            if not (self._refused and code == request_codes.MISSING_PART and part in form_kinds.VIEWS):
                self._add_error(code, message, f"/{part}")
        return Form(
            files={part: tuple(files) for part, files in self._files.items()},
            documents={name: bytes(content) for name, content in self._documents.items()},
            errors=tuple(self._errors),
        )

    def close(self) -> None:
        """Close a file that was not received completely."""
        if self._open is not None:
            with contextlib.suppress(OSError):  # The disk may be full; the file is no longer needed.
                self._open.file.close()
            self._open = None

    def _admit(self, part: str, name: str) -> bool:
        """Return whether a file is accepted; record an error if it is not."""
        index, pointer = self._counts[part], self._next_pointer(part)
        if part in form_kinds.VIEWS and index >= (max_files := self._limits.max_files(part)):
            if index == max_files:
                self._add_error(_TOO_MANY[part], f"A {self._kind.noun} has {max_files} {part} at most.", pointer)
        elif part not in form_kinds.VIEWS and index > 0:
            self._add_error(request_codes.DUPLICATE_PART, f"A {self._kind.noun} has one file of {part}.", pointer)
        elif message := name_error(name):
            self._add_error(request_codes.FILE_NAME_INVALID, message, pointer)
        elif _folded(name) in self._names:
            self._add_error(
                request_codes.DUPLICATE_FILE_NAME, f"Two files of the {self._kind.noun} have this name.", pointer, name
            )
        else:
            self._names.add(_folded(name))
            self._videos += [name] if part == form_kinds.VIDEOS else []
            return True
        return False

    def _next_pointer(self, part: str) -> str:
        """Count a file of a part and return its JSON pointer."""
        index = self._counts[part]
        self._counts[part] += 1
        return f"/{part}/{index}" if part in form_kinds.VIEWS else f"/{part}"

    def _add_error(
        self, code: Code, message: str, pointer: str, file: str | None = None, hint: str | None = None
    ) -> None:
        self._errors.append(ErrorItem(code=code, message=message, pointer=pointer, file=file, hint=hint))


def _num_stated_parts(manifest: bytes | bytearray) -> int:
    """Number of videos that a manifest states as further parts of recordings; 0 of a manifest that is wrong."""
    try:
        return sum(len(camera.get("more_files", ())) for camera in json.loads(manifest)["cameras"])
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return 0


def name_error(name: str) -> str | None:
    """Sentence about a wrong file name, or ``None``; a name must be valid on any system and never a path.

    >>> name_error("../cam_0.mp4")
    'The name of a file must not contain a path.'
    """
    if not name or name in {".", ".."}:
        return "The file has no name."
    if "/" in name or "\\" in name:
        return "The name of a file must not contain a path."
    # Categories Cc, Cf, Cs...: control characters, marks of the writing direction, lone surrogates.
    if any(unicodedata.category(character).startswith("C") for character in name):
        return "The name of a file must not contain control characters."
    if len(name.encode()) > _MAX_NAME_BYTES:
        return f"The name of a file must not be longer than {_MAX_NAME_BYTES} bytes."
    return None


def _discard(_data: bytes) -> None:
    pass


def _folded(name: str) -> str:
    """Normalized name, by which names are compared as file systems without case and with composed accents do."""
    return unicodedata.normalize("NFC", name).casefold()


def too_large(
    what: Literal["file", "part", "piece", "session"], max_bytes: int, part: str | None = None, file: str | None = None
) -> ApiError:
    """Error 413 for a file, part, piece or session above its limit."""
    item = ErrorItem(
        code=_TOO_LARGE[what],
        message=f"The {what} is larger than {max_bytes} bytes.",
        pointer=f"/{part}" if part else None,
        file=file if file and not name_error(file) else None,
    )
    return ApiError(request_codes.CONTENT_TOO_LARGE, f"The {what} is larger than the service accepts.", errors=(item,))
