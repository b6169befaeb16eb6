"""Recordings of cameras as they are stated, and the files of each video: stated ones, and others by their names."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from pipeline.capture.names import cameras_in_names, natural_key, nfc
from pipeline.capture.pairing import Thing
from pipeline.capture.parts import group_parts, missing_parts
from pipeline.capture.preflight_record import Recording
from pipeline.capture.video_files import VideoFiles
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import Problem
from pipeline.core.problems import session_codes


@dataclass(frozen=True, slots=True)
class SortedFiles:
    """Files of each video; of a recording in parts there are several, in order."""

    stated: Mapping[str, tuple[Path, ...]]  # Files by the name of their camera in the recording that names them
    free: Mapping[str, tuple[Path, ...]]  # Other files by the name of the first, for its pairing with a camera
    places: Mapping[Path, int]  # Places of the files in their list
    problems: Sequence[Problem]  # Files with the same name


def sort_files(files: VideoFiles, recordings: Sequence[Recording], cameras: Sequence[Camera]) -> SortedFiles:
    """Sort files into videos.

    Files are the parts of one recording if their names say so, unless they have the names of different cameras.
    """
    stated = {
        recording.camera: tuple(path for file in recording.files if (path := find_input(file, files.paths)) is not None)
        for recording in recordings
    }
    stated = {camera: paths for camera, paths in stated.items() if paths}
    taken = {path for paths in stated.values() for path in paths}
    name_of = dict(zip(files.paths, files.names, strict=True))
    names = [name for path, name in name_of.items() if path not in taken]
    path_of = {name: path for path, name in name_of.items() if path not in taken}
    doubled = {name for name, count in Counter(files.names).items() if count > 1} & set(names)
    problems = [
        Problem(
            session_codes.DUPLICATE_VIDEO,
            f"{files.names.count(name)} videos have the name {PurePosixPath(name).name}.",
            file=PurePosixPath(name).name,
            hint="Rename them.",
        )
        for name in sorted(doubled)
    ]
    # The parts that follow a file that is stated alone.
    for camera, paths in list(stated.items()):
        if len(paths) == 1:
            first = name_of[paths[0]]
            in_parts = next(parts for parts in group_parts([first, *path_of]) if first in parts)
            stated[camera] = tuple(path_of.pop(name, paths[0]) for name in in_parts)
    found = cameras_in_names(list(path_of), {camera.name: [camera.section] for camera in cameras})
    free: dict[str, tuple[Path, ...]] = {}
    for recording in group_parts(path_of):
        is_one = len({found[name] for name in recording}) == 1
        for parts in [recording] if is_one else [(name,) for name in recording]:
            free[parts[0]] = tuple(path_of[name] for name in parts)
    places = {path: place for place, path in enumerate(files.paths)}
    return SortedFiles(stated, free, places, problems)


def left_out_parts(names: Sequence[str]) -> Iterator[Problem]:
    """Report numbers that are left out between the names of a recording's parts."""
    if missing := missing_parts(names):
        numbers = ", ".join(map(str, missing))
        message = f"Of the recording {', '.join(names)} the part {numbers} is missing."
        yield Problem(
            session_codes.PARTS_GAP,
            message,
            file=names[0],
            hint="Add it, or send one part alone: a recording has no gap.",
        )


def known_recordings(
    recordings: Sequence[Recording], cameras: Sequence[Camera], inputs: Sequence[Path], thing: Thing = "video"
) -> tuple[dict[str, Recording], list[Problem]]:
    """Sort recordings by camera; report unknown cameras and inputs, and cameras and inputs that occur twice.

    ``inputs`` are all videos, or all folders of keypoints.
    """
    names = {camera.section: camera.name for camera in cameras} | {camera.name: camera.name for camera in cameras}
    hint = f"The calibration's cameras are {', '.join(sorted({*names.values()}, key=natural_key))}."
    known: dict[str, Recording] = {}
    taken: set[Path] = set()
    problems = []
    for recording in recordings:
        camera = names.get(recording.camera)
        paths = {file: find_input(file, inputs) for file in recording.files}
        if camera is None:
            message = "The calibration has no camera of this name."
            problems.append(
                Problem(session_codes.RECORDING_CAMERA_UNKNOWN, message, camera=recording.camera, hint=hint)
            )
            continue
        if camera in known:
            message = "There is more than one recording for this camera."
            problems.append(Problem(session_codes.DUPLICATE_RECORDING, message, camera=camera))
            continue
        wrong = [
            Problem(
                session_codes.RECORDING_FILE_UNKNOWN,
                f"There is no {thing} of this name.",
                file=Path(file).name,
                camera=camera,
            )
            for file, path in paths.items()
            if path is None
        ]
        found = [path for path in paths.values() if path is not None]
        if taken & set(found) or len(set(found)) < len(recording.files) - len(wrong):
            message = f"The {thing} is already assigned to a camera."
            doubled = next((path for path in found if path in taken), found[-1])
            wrong.append(Problem(session_codes.DUPLICATE_RECORDING_FILE, message, file=doubled.name, camera=camera))
        problems += wrong
        taken |= set(found)
        known[camera] = recording
    return known, problems


def find_input(file: str, paths: Sequence[Path]) -> Path | None:
    """Path of a file by its name or path, however their accents are composed."""
    return next((path for path in paths if nfc(file) in {nfc(path.name), nfc(str(path))}), None)
