"""Folders of keypoint files, one of each camera: a file of each frame, or one file of all frames."""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from pipeline.capture.keypoint_files import coco_wholebody, mediapipe, openpose
from pipeline.capture.keypoint_files.people import MAX_PEOPLE, CrowdError, KeypointsError, People
from pipeline.capture.pairing import MIN_CAMERAS
from pipeline.capture.parsing import UnreadableError, read_json
from pipeline.errors import Problem
from pipeline.findings import Finding

_FILE_NAME = re.compile(r"(?:.*\D)?(\d{1,15})_keypoints\.json", re.ASCII)
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


def camera_folders(folder: Path, findings: list[Finding], problems: list[Problem]) -> dict[str, Path]:
    """List the folders by name; report if there are too few, and tell of ignored files."""
    if not folder.is_dir():
        problems.append(Problem("keypoints_missing", "The folder does not exist.", file=folder.name))
        return {}
    entries = sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    findings += [
        Finding("file_ignored", f"{path.name} is ignored: it is not a folder.", severity="info")
        for path in entries
        if not path.is_dir()
    ]
    folders = {path.name: path for path in entries if path.is_dir()}
    if len(folders) < MIN_CAMERAS:
        problems.append(
            Problem(
                "too_few_folders",
                f"There are {len(folders)} folders; at least {MIN_CAMERAS} are required.",
                file=folder.name,
                hint="Provide a folder of keypoint files for each camera.",
            )
        )
    return folders


def read_folder(
    folder: Path, camera: str, max_joints: int, findings: list[Finding], problems: list[Problem]
) -> tuple[dict[int, People], int]:
    """Read people by frame number, in ascending order, and count their joints; stop above ``max_joints``.

    A folder has files of single frames, named by their numbers, or one JSON file of all frames.
    """
    numbered: dict[int, Path] = {}
    others: list[Path] = []
    folder_problems: list[Problem] = []
    for path in sorted(folder.iterdir()):
        match = _FILE_NAME.fullmatch(path.name)
        if match is None or not path.is_file():
            others.append(path)
        elif (number := int(match[1])) in numbered:
            folder_problems.append(
                Problem("duplicate_keypoints", f"{numbered[number].name} has the same frame number.", file=path.name)
            )
        else:
            numbered[number] = path
    captures = [path for path in others if path.suffix.lower() == ".json" and path.is_file()]
    is_capture = not numbered and len(captures) == 1
    if is_capture:
        others.remove(captures[0])
    if others:
        some = ", ".join(path.name for path in others[:3]) + (", ..." if len(others) > 3 else "")
        message = f"{len(others)} other files in {folder.name} are ignored: {some}."
        findings.append(Finding("file_ignored", message, severity="info", evidence={"num_files": len(others)}))
    if not numbered and not is_capture:
        hint = "Name the files like frame_000000000123_keypoints.json, or provide one JSON file of all frames."
        folder_problems.append(
            Problem("keypoints_none", "The folder has no keypoint file.", file=folder.name, hint=hint)
        )
    read = _read_capture(captures[0], camera) if is_capture else _read_frames(numbered, camera)
    frames: dict[int, People] = {}
    num_joints = 0
    for number, people in read:
        if isinstance(people, Problem):
            folder_problems.append(people)
        else:
            frames[number] = people
            num_joints += people.shape[0] * people.shape[1]
        if num_joints > max_joints:
            break
    problems += folder_problems[:_MAX_PROBLEMS_A_CAMERA]
    if len(folder_problems) > _MAX_PROBLEMS_A_CAMERA:
        more = len(folder_problems) - _MAX_PROBLEMS_A_CAMERA
        message = f"{more} more frames have problems." if is_capture else f"{more} more files have problems."
        problems.append(Problem("keypoints_unreadable", message, file=folder.name))
    return frames, num_joints


def _read_frames(numbered: Mapping[int, Path], camera: str) -> Iterator[tuple[int, People | Problem]]:
    """Read a file a frame, in order of the numbers."""
    for number, path in sorted(numbered.items()):
        yield number, _attempt(partial(_read_file, path), path, camera, number, _FRAME_HINT)


def _read_file(path: Path) -> People:
    content = _read(path, _MAX_FRAME_BYTES)
    return _format_of(content).read_frame(content)


def _read_capture(path: Path, camera: str) -> Iterator[tuple[int, People | Problem]]:
    """Read a file of all frames, in order of the numbers."""
    split = _attempt(partial(_split, path), path, camera, None, _FILE_HINT)
    if isinstance(split, Problem):
        yield 0, split
        return
    read_frame, frames = split
    for number, content in sorted(frames.items()):
        people = _attempt(partial(read_frame, content), path, camera, number, _FILE_HINT)
        if isinstance(people, Problem) and people.code == "keypoints_unreadable":
            people = replace(people, message=f"Frame {number}: {people.message}")
        yield number, people


def _split(path: Path) -> tuple[Callable[[Any], People], Mapping[int, Any]]:
    content = _read(path, MAX_FILE_BYTES)
    file_format = _format_of(content)
    if file_format is openpose:
        raise KeypointsError("OpenPose's files have a single frame and its number in their names.")
    return file_format.read_frame, file_format.frames_of(content)


def _read(path: Path, max_bytes: int) -> Any:
    if path.stat().st_size > max_bytes:
        raise KeypointsError(f"The file is larger than {max_bytes // 2**20} MiB.")
    return read_json(path.read_bytes())


def _format_of(content: Any) -> Any:
    """Module that reads the format of a file's content; that of OpenPose for unknown content."""
    if isinstance(content, list) or (isinstance(content, dict) and "annotations" in content):
        return coco_wholebody
    if isinstance(content, dict) and ("poses" in content or "frames" in content):
        return mediapipe
    return openpose


def _attempt(read: Callable[[], _Value], path: Path, camera: str, number: int | None, hint: str) -> _Value | Problem:
    """Value that ``read`` returns, or a problem of the file, and of the frame with the number."""
    file = f"{path.parent.name}/{path.name}"
    field = None
    try:
        return read()
    except CrowdError as error:
        message = f"Frame {number} has {error.num_people} people; at most {MAX_PEOPLE} are allowed."
        return Problem("too_many_people", message, file=file, camera=camera, hint=_CROWD_HINT)
    except KeypointsError as error:
        message, field = str(error), error.field
    except OSError:
        message = "The file can't be read."
    except (UnreadableError, TypeError, KeyError, AttributeError):
        message = "The file is not a keypoint file of a known format, or its people have different numbers of joints."
    return Problem("keypoints_unreadable", message, file=file, field=field, hint=hint)
