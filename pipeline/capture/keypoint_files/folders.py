"""Folders of keypoint files, one of each camera: a file of each frame, or one file of all frames."""

import filecmp
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar

from pipeline.capture.keypoint_files import forms
from pipeline.capture.keypoint_files.forms import endings, find_reader, frame_endings, load
from pipeline.capture.keypoint_files.keypoint_reader import KeypointReader
from pipeline.capture.keypoint_files.own_points import OwnPoints, with_own
from pipeline.capture.keypoint_files.people import MAX_PEOPLE, CrowdError, KeypointsError, People, check_frames
from pipeline.capture.keypoint_files.points import KeypointReading
from pipeline.capture.keypoint_files.readers import freemocap, yolo
from pipeline.capture.names import is_passed_over, passed_over
from pipeline.capture.pairing import MIN_CAMERAS
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import Problem, listed_names
from pipeline.core.findings import Finding
from pipeline.core.parsing import UnreadableError
from pipeline.core.paths import StrPath
from pipeline.core.problems import session_codes
from pipeline.core.problems.finding_codes import FILE_IGNORED

_FILE_NAME = re.compile(r"(?:.*\D)?(\d{1,15})_keypoints\.json", re.ASCII)
_LABELS = re.compile(r"(?:.*\D)?(\d{1,15})\.txt", re.ASCII)
_HDF5 = frozenset({".h5", ".hdf5"})
_MAX_FRAME_BYTES = 4 * 2**20
MAX_FILE_BYTES = 64 * 2**20
"""Limit on a file of all frames."""
# Thousands of bad files in a folder have one cause, which the first files show. ``errors.listed`` is no substitute: one
# bad folder would fill the whole list, and thousands of problems would be held in memory.
_MAX_PROBLEMS_A_CAMERA = 10
_CROWD_HINT = "Remove the people with the lowest scores, or mask a part of the image before detection."
_FRAME_HINT = "Write the file again, or remove it: a missing file means a dropped frame."
_FILE_HINT = "Write the file again."

_Value = TypeVar("_Value")


Source = Path | freemocap.CameraArray
"""Folder of a camera, or its part in the file of all cameras."""


def camera_folders(
    folder: Path, findings: list[Finding], problems: list[Problem], used: Sequence[Path] = ()
) -> Mapping[str, Source]:
    """List the folders by name; report if there are too few, and tell of ignored files.

    Without folders, the parts of FreeMoCap's file of all cameras are listed in their place. Files of the session that
    are read elsewhere, ``used``, and copies of them are not reported.
    """
    if not folder.is_dir():
        problems.append(Problem(session_codes.KEYPOINTS_MISSING, "The folder does not exist.", file=folder.name))
        return {}
    entries = sorted(path for path in folder.iterdir() if not path.name.startswith(".") and not is_passed_over(path))
    of_cameras = None if any(path.is_dir() for path in entries) else freemocap.file_of_cameras(entries)
    for path in entries:
        if path.is_dir() or path == of_cameras:
            continue
        if any(
            path.name == other.name and other.is_file() and filecmp.cmp(path, other, shallow=False) for other in used
        ):
            continue
        message = f"{path.name} is ignored: it is not a folder."
        if path.name == "timestamps.csv":
            message = "The times in timestamps.csv are not used: state the file as timestamps to use them."
        findings.append(Finding(FILE_IGNORED, message, severity="info"))
    if of_cameras is not None:
        parts = _attempt(partial(freemocap.split_cameras, of_cameras), of_cameras, None, None, _FILE_HINT)
        if isinstance(parts, Problem):
            problems.append(parts)
            return {}
        return parts
    folders = {path.name: path for path in entries if path.is_dir()}
    everything = [path for place in (folder, *folders.values()) for path in place.iterdir()]
    findings += passed_over(path for path in everything if is_passed_over(path))
    if len(folders) < MIN_CAMERAS:
        message = f"There are {len(folders)} folders; at least {MIN_CAMERAS} are required."
        hint = "Provide a folder of keypoint files for each camera."
        if kinds := forms.described(path.name for path in entries if path.is_file()):
            message, hint = f"{message} {kinds[0]}", f"{hint} {kinds[1]}"
        files = [path for path in entries if path.is_file() and path.suffix.lower() not in frame_endings()]
        if len(captures := _captures(files)) > 1:
            hint = f"Put each file into a folder with its camera's name, such as {captures[0].stem}/{captures[0].name}."
        problems.append(Problem(session_codes.TOO_FEW_FOLDERS, message, file=folder.name, hint=hint))
    return folders


@dataclass(frozen=True, slots=True, eq=False)
class Contents:
    """People of a folder."""

    frames: dict[int, People]  # People by frame number, in ascending order
    num_joints: int  # Number of their joints, detected or not
    forms: frozenset[str]  # Names of the forms of the files
    counts: frozenset[int]  # Numbers of points of a person that the files do not name
    own: tuple[str, ...]  # Names of the user's own points, which are columns of ``frames``; see ``own_points``


def stated_folders(
    stated: Mapping[str, StrPath], cameras: Sequence[Camera], problems: list[Problem]
) -> Mapping[str, Source]:
    """Folders by the cameras that they are stated to belong to; report those that can't be right.

    ``cameras`` are the calibration's cameras; none if it can't be read.
    """
    folders = {camera: Path(folder) for camera, folder in stated.items()}
    names = [camera.name for camera in cameras]
    for camera, folder in folders.items():
        if not folder.is_dir():
            problems.append(
                Problem(session_codes.KEYPOINTS_MISSING, "The folder does not exist.", file=folder.name, camera=camera)
            )
        if names and camera not in names:
            message, hint = "The calibration has no camera of this name.", f"It has {listed_names(names)}."
            problems.append(
                Problem(session_codes.RECORDING_CAMERA_UNKNOWN, message, file=folder.name, camera=camera, hint=hint)
            )
    places = [folder.resolve() for folder in folders.values()]
    for camera, folder in folders.items():
        if places.count(folder.resolve()) > 1:
            message = "The folder is stated for several cameras."
            problems.append(
                Problem(
                    session_codes.DUPLICATE_KEYPOINTS, message, file=folder.name, camera=camera, hint="State others."
                )
            )
    if len(folders) < MIN_CAMERAS:
        message = f"{len(folders)} folders are stated; at least {MIN_CAMERAS} cameras are needed."
        problems.append(Problem(session_codes.TOO_FEW_FOLDERS, message, hint="State a folder for each camera."))
    is_there = {camera: folder for camera, folder in folders.items() if folder.is_dir()}
    return is_there if not names else {camera: folder for camera, folder in is_there.items() if camera in names}


def read_folder(
    folder: Source,
    camera: str,
    size_px: tuple[int, int] | None,
    max_joints: int,
    findings: list[Finding],
    problems: list[Problem],
) -> Contents:
    """Read the people of a camera; stop above ``max_joints``.

    A folder has files of single frames, named by their numbers, or one file of all frames: JSON, CSV, HDF5
    or an array. ``size_px`` has width and height of the camera's images; ``None`` if unknown.
    """
    found = _Problems(folder)
    files = _Files({}, folder.path, []) if isinstance(folder, freemocap.CameraArray) else _choose(folder, found)
    if files.others:
        some = ", ".join(path.name for path in files.others[:3]) + (", ..." if len(files.others) > 3 else "")
        message = f"{len(files.others)} other files in {folder.name} are ignored: {some}."
        findings.append(Finding(FILE_IGNORED, message, severity="info", evidence={"num_files": len(files.others)}))
    reading = KeypointReading(size_px)
    frames: dict[int, People] = {}
    own: dict[int, Sequence[OwnPoints]] = {}
    num_joints = 0
    for number, people in (
        _read_frames(files.numbered, camera, reading)
        if files.capture is None
        else _read_capture(files.capture, camera, reading, folder.array if not isinstance(folder, Path) else None)
    ):
        of_frame = reading.take_own()
        if isinstance(people, Problem):
            found.add(people)
        else:
            frames[number], own[number] = people, of_frame
            num_joints += people.shape[0] * people.shape[1] + sum(
                part.size // 3 for own_points in of_frame for part in own_points[1:]
            )
        if num_joints > max_joints:
            break
    problems += found.listed("files" if files.capture is None else "frames")
    try:
        frames, names = with_own(frames, own)
    except KeypointsError as error:
        names = ()
        problems.append(Problem(session_codes.KEYPOINTS_UNREADABLE, str(error), file=folder.name, camera=camera))
    return Contents(frames, num_joints, frozenset(reading.forms), frozenset(reading.counts), names)


class _Problems:
    """Problems of a folder: the first ones, and how many more there are."""

    def __init__(self, folder: Source) -> None:
        self._folder = folder
        self._first: list[Problem] = []
        self._num_more = 0

    def add(self, problem: Problem) -> None:
        if len(self._first) < _MAX_PROBLEMS_A_CAMERA:
            self._first.append(problem)
        else:
            self._num_more += 1

    def listed(self, things: str) -> list[Problem]:
        if not self._num_more:
            return self._first
        message = f"{self._num_more} more {things} have problems."
        return [*self._first, Problem(session_codes.KEYPOINTS_UNREADABLE, message, file=self._folder.name)]


@dataclass(frozen=True, slots=True)
class _Files:
    """Files of a folder: of single frames by their numbers, or one of all frames; and others."""

    numbered: Mapping[int, Path]
    capture: Path | None
    others: Sequence[Path]


def _choose(folder: Path, problems: _Problems) -> _Files:
    """Choose the files to read; report if there are none, or frames of one number."""
    paths = sorted(path for path in folder.iterdir() if not is_passed_over(path))
    files = [path for path in paths if path.is_file()]
    named = [path for path in files if _FILE_NAME.fullmatch(path.name)]
    captures = _captures(files)
    labels = _labels(files)
    if labels and captures:
        message = f"The folder has files of two forms: {captures[0].name} and YOLO's labels {labels[0].name}."
        problems.add(
            Problem(session_codes.KEYPOINTS_NONE, message, file=folder.name, hint="Keep the files of one form.")
        )
        return _Files({}, None, [])
    if not named and len(captures) == 1:
        return _Files({}, captures[0], [path for path in paths if path != captures[0]])
    # Other programs name files of frames by the number alone.
    name = _FILE_NAME if named else _LABELS if labels else _numbered()
    numbered: dict[int, Path] = {}
    others: list[Path] = []
    for path in paths:
        match = name.fullmatch(path.name)
        if match is None or not path.is_file():
            others.append(path)
        elif (number := int(match[1])) in numbered:
            message = f"{numbered[number].name} has the same frame number."
            problems.add(Problem(session_codes.DUPLICATE_KEYPOINTS, message, file=path.name))
        else:
            numbered[number] = path
    if not numbered:
        message = "The folder has no keypoint file."
        hint = (
            "Name the files like frame_000000000123_keypoints.json, or provide one file of all frames: "
            "JSON, CSV, HDF5, .npy."
        )
        if captures:
            some = ", ".join(path.name for path in captures[:3])
            message, hint = f"The folder has several files without numbers: {some}.", f"Keep one of them. {hint}"
        elif known := forms.described(path.name for path in files):
            message, hint = f"{message} {known[0]}", known[1]
        problems.add(Problem(session_codes.KEYPOINTS_NONE, message, file=folder.name, hint=hint))
    return _Files(numbered, None, others)


@cache
def _numbered() -> re.Pattern[str]:
    """Names of files of a frame by its number alone."""
    endings_of_frames = "|".join(map(re.escape, sorted(frame_endings())))
    return re.compile(rf"(?:.*\D)?(\d{{1,15}})({endings_of_frames})", re.ASCII)


def _captures(files: Sequence[Path]) -> Sequence[Path]:
    """Files that may be of all frames; of DeepLabCut's CSV and HDF5 of one name, which have the same, the CSV."""
    tables = {path.stem for path in files if path.suffix.lower() == ".csv"}
    captures = [path for path in files if path.suffix.lower() in endings()]
    return [path for path in captures if path.suffix.lower() not in _HDF5 or path.stem not in tables]


def _labels(files: Sequence[Path]) -> Sequence[Path]:
    """Files of YOLO's labels; none if the first text with a number in its name that is not empty is of another kind."""
    texts = [path for path in files if _LABELS.fullmatch(path.name)]
    first = next((path for path in texts if path.stat().st_size), None)
    if first is None:
        return texts
    try:
        with first.open("rb") as file:
            return texts if yolo.is_labels(file.readline(_MAX_FRAME_BYTES)) else []
    except OSError:  # reported where the file is read
        return texts


def _choose_reader(path: Path, content: Any, reading: KeypointReading) -> KeypointReader:
    """Reader of a file's content; its format is noted."""
    reader = find_reader(path, content)
    if not isinstance(content, list) or content:  # an empty list may be of any program
        reading.forms.add(reader.name)
    return reader


def _read_frames(
    numbered: Mapping[int, Path], camera: str, reading: KeypointReading
) -> Iterator[tuple[int, People | Problem]]:
    """Read a file a frame, in order of the numbers."""
    for number, path in sorted(numbered.items()):
        yield number, _attempt(partial(_read_file, path, reading), path, camera, number, _FRAME_HINT)


def _read_file(path: Path, reading: KeypointReading) -> People:
    content = load(path, _MAX_FRAME_BYTES)
    return _choose_reader(path, content, reading).read(content, reading)


def _read_capture(
    path: Path, camera: str, reading: KeypointReading, content: Any = None
) -> Iterator[tuple[int, People | Problem]]:
    """Read a file of all frames, in order of the numbers; ``content`` is the file's content if it is known."""
    split = _attempt(partial(_split, path, reading, content), path, camera, None, _FILE_HINT)
    if isinstance(split, Problem):
        yield 0, split
        return
    reader, frames = split
    for number, frame in sorted(frames.items()):
        people = _attempt(partial(reader.read, frame, reading), path, camera, number, _FILE_HINT)
        if isinstance(people, Problem) and people.code == session_codes.KEYPOINTS_UNREADABLE:
            people = replace(people, message=f"Frame {number}: {people.message}")
        yield number, people


def _split(path: Path, reading: KeypointReading, content: Any) -> tuple[KeypointReader, Mapping[int, Any]]:
    content = load(path, MAX_FILE_BYTES) if content is None else content
    reader = _choose_reader(path, content, reading)
    number = _numbered().fullmatch(path.name)
    frames = reader.frames(content, None if number is None else int(number[1]))
    check_frames(len(frames))
    return reader, frames


def _attempt(
    read: Callable[[], _Value], path: Path, camera: str | None, number: int | None, hint: str
) -> _Value | Problem:
    """Value that ``read`` returns, or a problem of the file, and of the frame with the number."""
    file = f"{path.parent.name}/{path.name}"
    field = None
    try:
        return read()
    except CrowdError as error:
        message = f"Frame {number} has {error.num_people} people; at most {MAX_PEOPLE} are allowed."
        return Problem(session_codes.TOO_MANY_PEOPLE, message, file=file, camera=camera, hint=_CROWD_HINT)
    except KeypointsError as error:
        message, field = str(error), error.field
    except OSError:
        message = "The file can't be read."
    except (UnreadableError, TypeError, KeyError, AttributeError):
        message = "The file is not a keypoint file of a known format, or its people have different numbers of joints."
    return Problem(session_codes.KEYPOINTS_UNREADABLE, message, file=file, field=field, hint=hint)
