"""The form of a session: its parts, what they may be called, how large they may be.

What goes over a limit is refused at once; all else that is wrong with names and parts is collected while the rest is
read, so that one answer says all of it.
"""

import contextlib
import hashlib
import unicodedata
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from io import BufferedWriter
from pathlib import Path

from api.errors import ApiError, ErrorItem, pointer_to

VIDEOS, KEYPOINTS, CALIBRATION, TIMESTAMPS = "videos", "keypoints", "calibration", "timestamps"
VIEWS = (VIDEOS, KEYPOINTS)
"""Parts of which a form has one a camera; of the other files it has one."""

_MAX_NAME_BYTES = 200
# Parts beyond the videos: a few, right or wrong. Without an end to them their errors would fill the memory.
_MAX_OTHER_PARTS = 32


@dataclass(frozen=True, slots=True)
class Limits:
    """How much is taken in."""

    max_file_bytes: int
    max_keypoints_bytes: int
    max_session_bytes: int
    max_calibration_bytes: int
    max_json_bytes: int
    max_videos: int


@dataclass(frozen=True, slots=True)
class ReceivedFile:
    """A file of a form, whole and on disk under its own name."""

    name: str
    path: Path
    num_bytes: int
    sha256: str


@dataclass(frozen=True, slots=True)
class Form:
    """What a client sent.

    Parameters
    ----------
    documents
        The JSON parts by name, unparsed.
    errors
        All that is wrong with names and parts; the files that they concern are not among the others.
    """

    videos: tuple[ReceivedFile, ...]
    keypoints: tuple[ReceivedFile, ...]
    calibration: ReceivedFile | None
    timestamps: ReceivedFile | None
    documents: Mapping[str, bytes]
    errors: tuple[ErrorItem, ...]


@dataclass(slots=True)
class _OpenFile:
    """A file on its way to disk."""

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
    """What becomes of the parts of a form: files go to disk, JSON to memory, the rest nowhere."""

    def __init__(self, folder: Path, limits: Limits, documents: frozenset[str]) -> None:
        self._folder = folder
        self._limits = limits
        self._document_names = documents
        self._max_file_bytes = {
            VIDEOS: limits.max_file_bytes,
            KEYPOINTS: limits.max_keypoints_bytes,
            CALIBRATION: limits.max_calibration_bytes,
            TIMESTAMPS: limits.max_calibration_bytes,
        }
        self._files: dict[str, list[ReceivedFile]] = {part: [] for part in self._max_file_bytes}
        self._counts = dict.fromkeys(self._max_file_bytes, 0)
        self._names: set[str] = set()
        self._documents: dict[str, bytearray] = {}
        self._errors: list[ErrorItem] = []
        self._num_parts = 0
        self._total_bytes = 0
        self._open: _OpenFile | None = None
        self._write: Callable[[bytes], None] = _discard
        self._part, self._file_name, self._max_bytes, self._part_bytes = "", "", 0, 0

    def begin(self, part: str, file_name: str | None) -> None:
        """Begin a part."""
        self._num_parts += 1
        if self._num_parts > self._limits.max_videos + _MAX_OTHER_PARTS:
            raise ApiError("too_many_parts", "The form has too many parts.")
        self._part, self._file_name, self._part_bytes = part, file_name or "", 0
        # A refused part is read to its end, so that the answer says that it is refused, not that it is large.
        self._max_bytes = self._limits.max_session_bytes
        self._write = _discard
        if part in self._files:
            self._max_bytes = self._max_file_bytes[part]
            if self._admit(part, self._file_name):
                self._open = _OpenFile(self._file_name, (self._folder / self._file_name).open("xb"))
                self._write = self._open.write
        elif part in self._document_names and part not in self._documents:
            self._max_bytes = self._limits.max_json_bytes
            self._write = self._documents.setdefault(part, bytearray()).extend
        elif part in self._documents:
            self._blame("duplicate_part", "This part is there more than once.", f"/{part}")
        else:
            known = ", ".join([*self._files, *sorted(self._document_names)])
            self._blame("unknown_part", f"The form has a part that is not one of: {known}.", pointer_to(part[:100]))

    def write(self, data: bytes) -> None:
        """Take in some of a part."""
        self._part_bytes += len(data)
        self._total_bytes += len(data)
        if self._part_bytes > self._max_bytes:
            raise too_large("part", self._max_bytes, self._part, self._file_name)
        if self._total_bytes > self._limits.max_session_bytes:
            raise too_large("session", self._limits.max_session_bytes)
        self._write(data)

    def end(self) -> None:
        """End a part."""
        if self._open is not None:
            self._files[self._part].append(self._open.close())
            self._open = None

    def adopt(self, part: str, name: str, source: Path) -> None:
        """Take in a file that is there already, by a name of its own in the folder; ``source`` stays."""
        self._part, self._max_bytes = part, self._max_file_bytes[part]
        num_bytes = source.stat().st_size
        self._total_bytes += num_bytes
        if num_bytes > self._max_bytes:
            raise too_large("part", self._max_bytes, part, name)
        if self._total_bytes > self._limits.max_session_bytes:
            raise too_large("session", self._limits.max_session_bytes)
        if self._admit(part, name):
            path = self._folder / name
            path.hardlink_to(source)
            with path.open("rb") as file:
                sha256 = hashlib.file_digest(file, "sha256").hexdigest()
            self._files[part].append(ReceivedFile(name, path, num_bytes, sha256))

    def lack(self, part: str, code: str, message: str, hint: str, file: str | None = None) -> None:
        """Note that a file of a part is not there as it should be."""
        self._errors.append(
            ErrorItem(code=code, message=message, pointer=self._next_pointer(part), file=file, hint=hint)
        )

    def form(self) -> Form:
        """All parts, once the body has ended."""
        if not any(self._counts[part] for part in VIEWS):
            message = "There are no videos and no keypoints: a session needs either."
            self._blame("missing_part", message, f"/{VIDEOS}")
        if not self._counts[CALIBRATION]:
            message = "There is no calibration: a session needs one."
            self._blame("missing_part", message, f"/{CALIBRATION}")
        if self._counts[VIDEOS]:
            for part in (KEYPOINTS, TIMESTAMPS):
                if self._counts[part]:
                    self._blame("part_not_allowed", "A session of videos has no such files.", f"/{part}")
        return Form(
            videos=tuple(self._files[VIDEOS]),
            keypoints=tuple(self._files[KEYPOINTS]),
            calibration=next(iter(self._files[CALIBRATION]), None),
            timestamps=next(iter(self._files[TIMESTAMPS]), None),
            documents={name: bytes(content) for name, content in self._documents.items()},
            errors=tuple(self._errors),
        )

    def close(self) -> None:
        """Let go of a file that did not come to its end."""
        if self._open is not None:
            with contextlib.suppress(OSError):  # The disk may be full; the file is not wanted any more.
                self._open.file.close()
            self._open = None

    def _admit(self, part: str, name: str) -> bool:
        """Whether a file becomes the session's; if not, why is noted."""
        index, pointer = self._counts[part], self._next_pointer(part)
        if part in VIEWS and index >= self._limits.max_videos:
            if index == self._limits.max_videos:
                self._blame(f"too_many_{part}", f"A session has {self._limits.max_videos} {part} at most.", pointer)
        elif part not in VIEWS and index > 0:
            self._blame("duplicate_part", f"A session has one file of {part}.", pointer)
        elif message := name_error(name):
            self._blame("file_name_invalid", message, pointer)
        elif _folded(name) in self._names:
            self._blame("duplicate_file_name", "Two files of the session have this name.", pointer, name)
        else:
            self._names.add(_folded(name))
            return True
        return False

    def _next_pointer(self, part: str) -> str:
        """Count a file of a part; returns where it is."""
        index = self._counts[part]
        self._counts[part] += 1
        return f"/{part}/{index}" if part in VIEWS else f"/{part}"

    def _blame(self, code: str, message: str, pointer: str | None, file: str | None = None) -> None:
        self._errors.append(ErrorItem(code=code, message=message, pointer=pointer, file=file))


def name_error(name: str) -> str | None:
    """What is wrong with a file's name, if anything: it must be a name on any system, never a path.

    >>> name_error("../cam_0.mp4")
    'The name of a file must not hold a path.'
    """
    if not name or name in {".", ".."}:
        return "The file has no name."
    if "/" in name or "\\" in name:
        return "The name of a file must not hold a path."
    # Cc, Cf, Cs...: control characters, marks that turn the direction of writing, lone surrogates.
    if any(unicodedata.category(character).startswith("C") for character in name):
        return "The name of a file must not hold control characters."
    if len(name.encode()) > _MAX_NAME_BYTES:
        return f"The name of a file must not be longer than {_MAX_NAME_BYTES} bytes."
    return None


def _discard(_data: bytes) -> None:
    pass


def _folded(name: str) -> str:
    """A name as systems see it that tell no case from another and compose accents: what clashes there, clashes here."""
    return unicodedata.normalize("NFC", name).casefold()


def too_large(what: str, max_bytes: int, part: str | None = None, file: str | None = None) -> ApiError:
    """The answer to what goes over a limit."""
    item = ErrorItem(
        code=f"{what}_too_large",
        message=f"This is larger than {max_bytes} bytes.",
        pointer=f"/{part}" if part else None,
        file=file if file and not name_error(file) else None,
    )
    return ApiError("content_too_large", f"The {what} is larger than the service takes.", errors=(item,))
