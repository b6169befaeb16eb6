"""Takes of a batch: a folder each, or the entries of a list."""

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from api.cli.sources import SourceOptions, stated_camera
from pipeline.capture.names import natural_key
from pipeline.capture.session import Session
from pipeline.capture.video_files import footage_in
from pipeline.core.errors import InputError, Problem
from pipeline.core.options.job_choices import Units, Up
from pipeline.core.problems.finding_codes import TAKE_EMPTY, TAKE_UNCALIBRATED, TAKES_UNREADABLE

_KEYPOINTS, _TIMESTAMPS, _CALIBRATION = "keypoints", "timestamps.csv", "calibration.*"
_MAX_LIST_BYTES = 2**24


@dataclass(frozen=True, slots=True)
class TakeSource:
    """Files of a take."""

    name: str  # Name of the folder of its results
    videos: tuple[str, ...]  # Folder of videos, or videos, like ``--videos``; empty for keypoints
    keypoints: Path | None
    timestamps: Path | None
    calibration: Path | None  # ``None``: the batch has none, and neither has the take
    frame_rate_hz: float | None  # Rate of keypoints without timestamps, or of images

    def open(self, units: Units | None, pair_by_order: bool, up: Up = "z", layout: str | None = None) -> Session:
        """Open the session; raises ``InputError`` with all problems of its files."""
        if self.calibration is None:
            raise InputError([Problem(TAKE_UNCALIBRATED, "There is no calibration.", hint="Give --calibration.")])
        if not self.videos and self.keypoints is None:
            hint = f"Put videos, or the folder {_KEYPOINTS}, there."
            raise InputError([Problem(TAKE_EMPTY, "There are neither videos nor keypoints.", hint=hint)])
        rate_hz = None if self.timestamps is not None else self.frame_rate_hz
        options = SourceOptions(
            list(map(Path, self.videos)),
            keypoints=None if self.keypoints is None else [self.keypoints],
            timestamps=self.timestamps,
            frame_rate=rate_hz,
            layout=None if self.keypoints is None else layout,
            pair_by_order=pair_by_order,
            units=units,
            up=up,
        )
        return options.open(self.calibration)

    def fingerprint(self) -> str:
        """Digest of the names, sizes and times of change of all files, and of the calibration's content."""
        digest = hashlib.sha256()
        given = [stated_camera(Path(video))[1] for video in self.videos]
        for root in (*given, self.keypoints, self.timestamps):
            for path in () if root is None else sorted(_files(root)):
                facts = path.stat()
                digest.update(json.dumps([str(path), facts.st_size, facts.st_mtime_ns]).encode())
        if self.calibration is not None and self.calibration.is_file():
            digest.update(self.calibration.read_bytes())
        digest.update(repr(self.frame_rate_hz).encode())
        return digest.hexdigest()


class _Entry(BaseModel):
    """Take of a list."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str = Field(min_length=1, max_length=100, pattern=r"^[^/\\\x00-\x1f]+$")
    videos: str | list[str] | None = None
    keypoints: str | None = None
    timestamps: str | None = None
    calibration: str | None = None
    frame_rate_hz: float | None = Field(None, gt=0, le=1000)

    @model_validator(mode="after")
    def _one_source(self) -> "_Entry":
        if (self.videos is None) == (self.keypoints is None):
            raise ValueError("a take has either videos or keypoints")
        if self.name in {".", ".."}:
            raise ValueError("the name can't be a folder's")
        return self


class _List(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    takes: list[_Entry] = Field(min_length=1, max_length=10_000)


def find_takes(
    source: Path, results: Path, calibration: Path | None, frame_rate_hz: float | None
) -> Sequence[TakeSource]:
    """Takes of a folder, in the natural order of their names, or of a list, in its order.

    ``source``: folder with a folder for each take, or a JSON file with ``takes``; its paths are relative to the file.
    ``results``: folder of results, which is no take. ``calibration``, ``frame_rate_hz``: of takes without their own.
    Raises ``InputError`` if there is no take, or the list can't be read; with all problems of the list.
    """
    if not source.is_dir():
        return list(_listed(source, calibration, frame_rate_hz))
    try:
        folders = [
            path
            for path in source.iterdir()
            if path.is_dir() and not path.name.startswith((".", "__")) and path.resolve() != results.resolve()
        ]
    except OSError as error:
        raise _unreadable(source, f"The folder can't be read: {error.strerror}.") from error
    if not folders:
        raise _unreadable(source, "The folder has no folder of a take.")
    ordered = sorted(folders, key=lambda path: natural_key(path.name))
    return [_folder_take(path, calibration, frame_rate_hz) for path in ordered]


def _folder_take(folder: Path, calibration: Path | None, frame_rate_hz: float | None) -> TakeSource:
    """Take in a folder: its videos or images, or keypoints in folders of cameras."""
    own = sorted(path for path in folder.glob(_CALIBRATION) if path.is_file())
    keypoints = _keypoints_in(folder)
    footage = [] if keypoints is not None else footage_in(folder)
    needs_rate = keypoints is not None or all(path.is_dir() for path in footage)
    timestamps = folder / _TIMESTAMPS
    return TakeSource(
        folder.name,
        (str(folder),) if footage else (),
        keypoints,
        timestamps if keypoints is not None and timestamps.is_file() else None,
        own[0] if own else calibration,
        frame_rate_hz if needs_rate else None,
    )


def _keypoints_in(folder: Path) -> Path | None:
    """Folder of keypoints of a take: ``keypoints``, or the take's own if it has folders and no footage."""
    if (folder / _KEYPOINTS).is_dir():
        return folder / _KEYPOINTS
    has_folders = any(path.is_dir() and not path.name.startswith((".", "__")) for path in folder.iterdir())
    return folder if has_folders and not footage_in(folder) else None


def _listed(path: Path, calibration: Path | None, frame_rate_hz: float | None) -> Iterator[TakeSource]:
    try:
        with path.open("rb") as file:
            content = file.read(_MAX_LIST_BYTES + 1)
    except OSError as error:
        raise _unreadable(path, f"The file can't be read: {error.strerror}.") from error
    if len(content) > _MAX_LIST_BYTES:
        raise _unreadable(path, "The list is too long.")
    try:
        takes = _List.model_validate_json(content).takes
    except ValidationError as error:
        problems = [
            Problem(
                TAKES_UNREADABLE, f"{wrong['msg']}.", file=path.name, field=".".join(map(str, wrong["loc"])) or None
            )
            for wrong in error.errors(include_url=False, include_input=False)
        ]
        raise InputError(problems) from error
    names = [entry.name.casefold() for entry in takes]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise _unreadable(path, f"Takes have the same name: {', '.join(twice)}.")

    def near(name: str | None) -> Path | None:
        return None if name is None else path.parent / name

    for entry in takes:
        videos = [entry.videos] if isinstance(entry.videos, str) else entry.videos or []
        yield TakeSource(
            entry.name,
            tuple(_beside(path.parent, video) for video in videos),
            near(entry.keypoints),
            near(entry.timestamps),
            near(entry.calibration) or calibration,
            entry.frame_rate_hz or frame_rate_hz,
        )


def _beside(folder: Path, video: str) -> str:
    camera, sign, name = video.partition("=")
    return f"{camera}={folder / name}" if sign and not (folder / video).exists() else str(folder / video)


def _files(root: Path) -> Iterator[Path]:
    if root.is_dir():
        yield from (path for path in root.rglob("*") if path.is_file())
    elif root.is_file():
        yield root


def _unreadable(path: Path, message: str) -> InputError:
    return InputError([Problem(TAKES_UNREADABLE, message, file=path.name)])
