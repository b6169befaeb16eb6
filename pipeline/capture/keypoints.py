"""Open a session of 2D joints that another program detected: OpenPose's JSON, a folder a camera.

A folder contains a file a frame, such as ``frame_000000000123_keypoints.json``; the digits before ``_keypoints`` are
the frame number. ``pose_keypoints_2d`` contains x, y and score of 25 (BODY_25), 18 (COCO-18) or 17 (COCO-17) joints. A
joint is undetected if its score is 0 or less, or if a number is not finite. People without a detected joint are left
out. A missing file means a dropped frame.
"""

import csv
import math
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from pipeline.calibration.registry import Units, read_calibration
from pipeline.capture.clock import TimeSource, clock_problems
from pipeline.capture.pairing import pair_by_name
from pipeline.capture.parsing import UnreadableError, read_json, read_numbers
from pipeline.capture.quantities import FRAME_RATE_HZ, FRAME_RATE_TOLERANCE, KEYPOINT_PX, TIME_S
from pipeline.capture.session import MIN_CAMERAS
from pipeline.data import Camera, Detections, FrameTimes, Timebase
from pipeline.errors import InputError, Problem
from pipeline.joints import BODY_25, COCO_17, COCO_18, JointSet
from pipeline.video.frame_rate import DEFAULT_RATE, measured_rate_hz, without_rounding
from pipeline.video.timeline import recorded_stretches

DEFAULT_FRAME_RATE_HZ = float(DEFAULT_RATE)

_FILE_NAME = re.compile(r"(?:.*\D)?(\d{1,15})_keypoints\.json", re.ASCII)
_FORMATS: Mapping[int, JointSet] = {3 * len(joints.names): joints for joints in (BODY_25, COCO_18, COCO_17)}
_MAX_FILE_BYTES = 4 * 2**20
MAX_PEOPLE = 128
"""Limit on the people of a camera in a frame; association takes some seconds for a frame with so many people."""
MAX_JOINTS = 25_000_000
"""Limit on the joints of a session, detected or not: two hours of two people, four cameras, 17 joints and 25 Hz.

A worker uses about 85 bytes of memory a joint.
"""
# Limit on the people listed in a file, including people without a detected joint.
_MAX_LISTED_PEOPLE = 1000
# Thousands of bad files in a folder have one cause, which the first files show. ``errors.listed`` is no substitute: one
# bad folder would fill the whole list, and thousands of problems would be held in memory.
_MAX_PROBLEMS_A_CAMERA = 10
# Lowest score of a detected joint: far below the scores of detectors, far above numbers whose squares are 0.
_MIN_SCORE = 1e-9
_MAX_START_S = 3600.0
_START_HINT = "Subtract the time at which the capture started."

People = Float[np.ndarray, "_ _ 3"]  # (people, joints, x y score); the number of people differs from frame to frame


@dataclass(frozen=True, slots=True, eq=False)
class KeypointSession:
    """Calibrated cameras and the 2D joints detected in their frames.

    Parameters
    ----------
    cameras
        Cameras in the order of the calibration.
    times
        Frame times of each camera on the session's clock, by camera name.
    timebase
        Output frames. Without timestamps, output frame k is file number k.
    detections
        Detections by camera name.
    joints
        Joint set of the detections.
    folders
        Name of the folder of each camera, by camera name.
    warnings
        Sentences for the user.
    """

    cameras: tuple[Camera, ...]
    times: Mapping[str, FrameTimes]
    timebase: Timebase
    detections: Mapping[str, Detections]
    joints: JointSet
    folders: Mapping[str, str]
    warnings: tuple[str, ...]

    @property
    def stretches(self) -> tuple[range, ...]:
        """Ranges of all output frames without long pauses in the detections; see ``recorded_stretches``."""
        return recorded_stretches(
            self.timebase, (self.times[name].time_s[detections.frame] for name, detections in self.detections.items())
        )


def open_keypoints(
    folder: Path,
    calibration: Path,
    timestamps: Path | None = None,
    frame_rate_hz: float | None = None,
    units: Units = "m",
    max_joints: int | None = None,
) -> KeypointSession:
    """Open a folder that contains a folder of keypoint files for each camera.

    A folder belongs to the camera of the same name. If no folder has the name of a camera, folders and cameras are
    paired in sorted order, and a warning lists the pairs.

    Parameters
    ----------
    timestamps
        CSV file with the columns ``camera``, ``frame`` and ``time_s``: seconds on the clock that all cameras share,
        which starts at 0. Without it, frame k of all cameras is at k / ``frame_rate_hz``.
    frame_rate_hz
        Rate of all cameras; 25 by default, with a warning. Not allowed together with ``timestamps``.
    units
        See ``read_calibration``.
    max_joints
        Limit on the joints of all people in all files, detected or not; ``None``: no limit. Reading stops at the limit.

    Raises
    ------
    InputError
        With all problems of all files.
    """
    problems: list[Problem] = []
    warnings: list[str] = []
    cameras: tuple[Camera, ...] = ()
    try:
        cameras = read_calibration(calibration, units)
    except InputError as error:
        problems.extend(error.problems)
    folders = _camera_folders(folder, warnings, problems)
    pairs: Mapping[str, str] = {}
    if cameras and folders:
        pairs, unpaired, pairing_warnings = pair_by_name(cameras, list(folders), "folder")
        problems += unpaired
        warnings += pairing_warnings
    camera_of = {name: camera for camera, name in pairs.items()}
    frames: dict[str, dict[int, People]] = {}
    left_joints = sys.maxsize if max_joints is None else max_joints
    for name, path in folders.items():
        frames[name], num_joints = _read_folder(path, camera_of.get(name, name), left_joints, warnings, problems)
        left_joints -= num_joints
        if left_joints < 0:
            message = f"With this camera's files the session has more than {max_joints:,} joints."
            hint = "Cut it into several sessions."
            problems.append(Problem("session_too_large", message, camera=camera_of.get(name, name), hint=hint))
            raise InputError(problems)
    joints = _joint_set(frames, problems)
    people_by_camera = {camera: frames[name] for camera, name in pairs.items()}
    if timestamps is not None and frame_rate_hz is not None:
        problems.append(
            Problem("two_clocks", "There are both timestamps and a frame rate.", hint="Provide only one of them.")
        )
    times, timebase = (
        _times_from_rate(people_by_camera, pairs, frame_rate_hz, warnings, problems)
        if timestamps is None
        else _times_from_file(people_by_camera, timestamps, problems)
    )
    if problems or joints is None or timebase is None:
        raise InputError(problems)
    warnings += [
        f"Camera {camera} saw nobody."
        for camera, by_frame in people_by_camera.items()
        if not sum(map(len, by_frame.values()))
    ]
    return KeypointSession(
        cameras=cameras,
        times=times,
        timebase=timebase,
        detections={
            camera: _as_detections(camera, list(by_frame.values()), joints)
            for camera, by_frame in people_by_camera.items()
        },
        joints=joints,
        folders=pairs,
        warnings=tuple(warnings),
    )


def _camera_folders(folder: Path, warnings: list[str], problems: list[Problem]) -> dict[str, Path]:
    """List the folders by name; report if there are too few, and warn of ignored files."""
    if not folder.is_dir():
        problems.append(Problem("keypoints_missing", "The folder does not exist.", file=folder.name))
        return {}
    entries = sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    warnings.extend(f"{path.name} is ignored: it is not a folder." for path in entries if not path.is_dir())
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


def _read_folder(
    folder: Path, camera: str, max_joints: int, warnings: list[str], problems: list[Problem]
) -> tuple[dict[int, People], int]:
    """Read people by frame number, in ascending order, and count their joints; stop above ``max_joints``."""
    numbered: dict[int, Path] = {}
    ignored: list[str] = []
    folder_problems: list[Problem] = []
    for path in sorted(folder.iterdir()):
        match = _FILE_NAME.fullmatch(path.name)
        if match is None or not path.is_file():
            ignored.append(path.name)
        elif (number := int(match[1])) in numbered:
            folder_problems.append(
                Problem("duplicate_keypoints", f"{numbered[number].name} has the same frame number.", file=path.name)
            )
        else:
            numbered[number] = path
    if ignored:
        some = ", ".join(ignored[:3]) + (", ..." if len(ignored) > 3 else "")
        warnings.append(f"{len(ignored)} other files in {folder.name} are ignored: {some}.")
    if not numbered:
        hint = "Name the files like frame_000000000123_keypoints.json."
        folder_problems.append(
            Problem("keypoints_none", "The folder has no keypoint file.", file=folder.name, hint=hint)
        )
    frames: dict[int, People] = {}
    num_joints = 0
    for number, path in sorted(numbered.items()):
        if num_joints > max_joints:
            break
        read = _read_file(path, camera, number)
        if isinstance(read, Problem):
            folder_problems.append(read)
        else:
            frames[number] = read
            num_joints += read.shape[0] * read.shape[1]
    problems += folder_problems[:_MAX_PROBLEMS_A_CAMERA]
    if len(folder_problems) > _MAX_PROBLEMS_A_CAMERA:
        more = len(folder_problems) - _MAX_PROBLEMS_A_CAMERA
        problems.append(Problem("keypoints_unreadable", f"{more} more files have problems.", file=folder.name))
    return frames, num_joints


def _read_file(path: Path, camera: str, number: int) -> People | Problem:
    """Read the people of a frame with at least one detected joint, or return a problem.

    The array has no people where the file has none, and no joints either where the file lists nobody.
    """
    file = f"{path.parent.name}/{path.name}"
    try:
        return _parse(path)
    except _CrowdError as error:
        message = f"Frame {number} has {error.num_people} people; at most {MAX_PEOPLE} are allowed."
        hint = "Remove the people with the lowest scores, or mask a part of the image before detection."
        return Problem("too_many_people", message, file=file, camera=camera, hint=hint)
    except _UnreadableError as error:
        message = str(error)
    except OSError:
        message = "The file can't be read."
    except (UnreadableError, TypeError, KeyError):
        message = "The file is not a keypoint file of OpenPose, or its people have different numbers of joints."
    hint = "Write the file again, or remove it: a missing file means a dropped frame."
    return Problem("keypoints_unreadable", message, file=file, hint=hint)


class _UnreadableError(Exception):
    """The file can't be used; the text is the message of its problem."""


class _CrowdError(Exception):
    """A frame has more people than allowed."""

    def __init__(self, num_people: int) -> None:
        super().__init__(f"{num_people} people")
        self.num_people = num_people


class _LateError(_UnreadableError):
    """A time is later than the longest capture."""


def _parse(path: Path) -> People:
    if path.stat().st_size > _MAX_FILE_BYTES:
        raise _UnreadableError(f"The file is larger than {_MAX_FILE_BYTES // 2**20} MiB.")
    listed = [person["pose_keypoints_2d"] for person in read_json(path.read_bytes())["people"]]
    if len(listed) > _MAX_LISTED_PEOPLE:
        raise _CrowdError(len(listed))
    # People of zeros are dropped as lists: converting hundreds of them to arrays would take milliseconds a frame.
    people = [person for person in listed if len(person) not in _FORMATS or any(person)]
    if not people:
        return np.empty((0, len(listed[0]) // 3 if listed else 0, 3))
    values = read_numbers(people)
    if values.ndim != 2 or values.shape[1] not in _FORMATS:
        count = values[0].size
        raise _UnreadableError(f"A person has {count} numbers; BODY_25 has 75, COCO-18 has 54, COCO-17 has 51.")
    joints = values.reshape(len(people), -1, 3)
    detected = _is_detected(joints)
    if not KEYPOINT_PX.holds(joints[detected, :2]):
        raise _UnreadableError(f"A coordinate of a joint is not within {KEYPOINT_PX}.")
    joints = joints[detected.any(-1)]
    if len(joints) > MAX_PEOPLE:
        raise _CrowdError(len(joints))
    return joints


def _is_detected(people: People) -> Bool[np.ndarray, "_ _"]:
    return np.isfinite(people).all(-1) & (people[..., 2] >= _MIN_SCORE)


def _joint_set(frames: Mapping[str, Mapping[int, People]], problems: list[Problem]) -> JointSet | None:
    """Joint set of all files; ``None`` and a problem if the files differ or have no joints."""
    formats = {name: {3 * people.shape[1] for people in by_frame.values()} - {0} for name, by_frame in frames.items()}
    used = set().union(*formats.values()) if formats else set()
    if len(used) > 1:
        shown = ", ".join(
            f"{name}: {' and '.join(str(count // 3) for count in sorted(counts))} joints"
            for name, counts in formats.items()
            if counts
        )
        problems.append(
            Problem(
                "keypoints_mixed",
                f"The files have several joint sets ({shown}).",
                hint="Use one joint set for all files.",
            )
        )
        return None
    if not used:
        if frames and not problems:
            problems.append(
                Problem("keypoints_empty", "No camera detected anybody.", hint="Check the detector's output.")
            )
        return None
    return _FORMATS[used.pop()]


def _times_from_rate(
    frames: Mapping[str, Mapping[int, People]],
    folders: Mapping[str, str],
    frame_rate_hz: float | None,
    warnings: list[str],
    problems: list[Problem],
) -> tuple[dict[str, FrameTimes], Timebase | None]:
    """Times from frame numbers: frame k of all cameras is at k over the frame rate."""
    rate_hz = DEFAULT_FRAME_RATE_HZ if frame_rate_hz is None else frame_rate_hz
    if frame_rate_hz is None:
        warnings.append(f"No frame rate was given: {rate_hz:g} Hz is assumed.")
    if not FRAME_RATE_HZ.holds(rate_hz):
        problems.append(
            Problem("frame_rate", f"A frame rate of {rate_hz:g} Hz is not allowed.", hint=f"Use {FRAME_RATE_HZ}.")
        )
        return {}, None
    rate_hz = float(without_rounding(rate_hz))
    times = {
        camera: FrameTimes(np.array(list(by_frame), dtype=np.float64) / rate_hz) for camera, by_frame in frames.items()
    }
    source = TimeSource(
        files=folders,
        start_field="frame",
        rate_field="frame",
        start_hint="Check the numbers of the files: the number divided by the frame rate is the time of the frame.",
        rate_hint="Number the files from the start of the capture; cut a longer capture into several sessions.",
    )
    if times and all(frames.values()):
        problems += clock_problems(times, 0.0, rate_hz, source)
    last = max((max(by_frame, default=0) for by_frame in frames.values()), default=0)
    return times, Timebase(0.0, rate_hz, last + 1)


def _times_from_file(
    frames: Mapping[str, Mapping[int, People]], timestamps: Path, problems: list[Problem]
) -> tuple[dict[str, FrameTimes], Timebase | None]:
    """Times from the file of timestamps; output frames start at 0 and have the rate of the fastest camera."""
    times: dict[str, FrameTimes] = {}
    read = _read_timestamps(timestamps, frames.keys(), problems)
    if read is None:
        return times, None
    for camera, by_frame in frames.items():
        missing = [number for number in by_frame if number not in read.get(camera, {})]
        if missing:
            message = f"{len(missing)} frames have no time; the first is frame {missing[0]}."
            problems.append(Problem("timestamps_missing", message, file=timestamps.name, camera=camera))
            continue
        time_s = np.array([read[camera][number] for number in by_frame], dtype=np.float64)
        if (np.diff(time_s) <= 0).any():
            first = list(by_frame)[int(np.argmax(np.diff(time_s) <= 0)) + 1]
            message = f"Times must ascend from frame to frame; the time of frame {first} does not."
            problems.append(Problem("timestamps_order", message, file=timestamps.name, camera=camera))
            continue
        times[camera] = FrameTimes(time_s)
    if problems or not times:
        return times, None
    if min(camera_times.time_s[0] for camera_times in times.values() if len(camera_times.time_s)) > _MAX_START_S:
        problems.append(Problem("timestamps_start", "Times must count from 0.", file=timestamps.name, hint=_START_HINT))
        return times, None
    rates_hz = [
        measured_rate_hz(camera_times.time_s) for camera_times in times.values() if len(camera_times.time_s) > 1
    ]
    if not rates_hz:
        problems.append(Problem("too_few_frames", "No camera has two frames.", file=timestamps.name))
        return times, None
    rate_hz = max(rates_hz)
    if not FRAME_RATE_HZ.holds(rate_hz, FRAME_RATE_TOLERANCE):
        message = f"By the times the fastest camera has {rate_hz:g} frames a second; {FRAME_RATE_HZ} are allowed."
        hint = "Check that the times are in seconds."
        problems.append(Problem("frame_rate", message, file=timestamps.name, field="time_s", hint=hint))
    source = TimeSource(
        files=dict.fromkeys(times, timestamps.name),
        start_field="time_s",
        rate_field="time_s",
        start_hint="Check the times: seconds since the start of the capture, by a clock that all cameras share.",
        rate_hint="Times are seconds since the start of the capture. Cut a longer capture into several sessions.",
    )
    if all(frames.values()):
        problems += clock_problems(times, 0.0, rate_hz, source)
    if problems:
        return times, None
    end_s = max(float(camera_times.time_s[-1]) for camera_times in times.values())
    return times, Timebase(0.0, rate_hz, round(end_s * rate_hz) + 1)


def _read_timestamps(path: Path, cameras: Iterable[str], problems: list[Problem]) -> dict[str, dict[int, float]] | None:
    """Read times in seconds by camera and frame number; rows of unknown cameras are ignored.

    Returns ``None`` and adds a problem if a row is invalid.
    """
    times_s: dict[str, dict[int, float]] = {camera: {} for camera in cameras}
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = csv.DictReader(file)
            for row in rows:
                _add_row(row, rows.line_num, times_s)
    except _LateError as error:
        problems.append(Problem("timestamps_start", str(error), file=path.name, hint=_START_HINT))
    except _UnreadableError as error:
        problems.append(Problem("timestamps_invalid", str(error), file=path.name))
    except FileNotFoundError:
        problems.append(Problem("timestamps_invalid", "The file does not exist.", file=path.name))
    except (OSError, ValueError, csv.Error):
        problems.append(Problem("timestamps_invalid", "The file can't be read as CSV.", file=path.name))
    else:
        return times_s
    return None


def _add_row(row: Mapping[str, str], line: int, times_s: Mapping[str, dict[int, float]]) -> None:
    if not {"camera", "frame", "time_s"} <= row.keys():
        raise _UnreadableError("The file needs the columns camera, frame and time_s.")
    if row["camera"] not in times_s:
        return
    try:
        frame, time_s = int(row["frame"]), float(row["time_s"])
    except (TypeError, ValueError):
        raise _UnreadableError(f"Line {line} has no valid frame number and time.") from None
    if TIME_S.high < time_s < math.inf:  # usually seconds since 1970
        raise _LateError(f"Times must count from 0; the time in line {line} is not {TIME_S}.")
    if not TIME_S.holds(time_s):
        raise _UnreadableError(f"The time in line {line} is not {TIME_S}.")
    if frame in times_s[row["camera"]]:
        raise _UnreadableError(f"Line {line} gives frame {frame} of {row['camera']} a second time.")
    times_s[row["camera"]][frame] = time_s


def _as_detections(camera: str, frames: Sequence[People], joints: JointSet) -> Detections:
    """Build the detections of a camera; frames are numbered by their position in ``times``."""
    num_joints = len(joints.names)
    people = np.concatenate(
        [np.empty((0, num_joints, 3)), *(people_of_frame for people_of_frame in frames if len(people_of_frame))]
    )
    points_px, score = people[..., :2], people[..., 2]
    detected = _is_detected(people)
    keypoints_px = np.where(detected[..., None], points_px, np.nan)
    return Detections(
        camera=camera,
        frame=np.repeat(np.arange(len(frames)), [len(people_of_frame) for people_of_frame in frames]),
        keypoints_px=keypoints_px,
        score=np.where(detected, np.clip(score, 0.0, 1.0), 0.0),
        box_px=_boxes(keypoints_px),
    )


def _boxes(keypoints_px: Float[np.ndarray, "n joints 2"]) -> Float[np.ndarray, "n 4"]:
    """Boxes around detected joints as (left, top, right, bottom); NaN without a detected joint."""
    known = np.isfinite(keypoints_px)
    low = np.where(known, keypoints_px, np.inf).min(1, initial=np.inf)
    high = np.where(known, keypoints_px, -np.inf).max(1, initial=-np.inf)
    boxes = np.concatenate([low, high], axis=1)
    return np.where(np.isfinite(boxes), boxes, np.nan)
