"""Times of frames: from the numbers of the frames, or from a CSV file of timestamps."""

import csv
import math
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np

from pipeline.capture.clock import TimeSource, clock_problems
from pipeline.capture.keypoint_files.people import People
from pipeline.capture.names import nfc
from pipeline.core.data.cameras import FrameTimes, Timebase
from pipeline.core.errors import Problem
from pipeline.core.findings import Finding
from pipeline.core.parsing import FRAME_RATE_HZ, FRAME_RATE_TOLERANCE, TIME_S, open_table
from pipeline.core.problems import session_codes
from pipeline.core.problems.finding_codes import FRAMES_DROPPED
from pipeline.video.frame_rate import DEFAULT_RATE, measured_rate_hz, without_rounding

_COLUMNS = ("camera", "frame", "time_s")
_MAX_START_S = 3600.0
_START_HINT = "Subtract the time at which the capture started."


class _InvalidError(Exception):
    """The file of timestamps can't be used; the text is the message of its problem."""


class _LateError(_InvalidError):
    """A time is later than the longest capture."""


def times_from_rate(
    frames: Mapping[str, Mapping[int, People]],
    folders: Mapping[str, str],
    rate_hz: float | None,
    findings: list[Finding],
    problems: list[Problem],
) -> tuple[dict[str, FrameTimes], Timebase | None]:
    """Times from frame numbers: frame k of all cameras is at k over the frame rate, which must be known.

    Output frames run from the first number of all cameras to the last one.
    """
    if rate_hz is None:
        message = "Keypoints have no times: the frame rate of their videos must be stated, or their timestamps."
        hint = "State frames a second (--frame-rate, or frame_rate_hz in the manifest), or give timestamps."
        problems.append(Problem(session_codes.NO_FRAME_RATE, message, field="frame_rate_hz", hint=hint))
        return {}, None
    if not FRAME_RATE_HZ.holds(rate_hz):
        problems.append(
            Problem(
                session_codes.FRAME_RATE,
                f"A frame rate of {rate_hz:g} Hz is not allowed.",
                hint=f"Use {FRAME_RATE_HZ}.",
            )
        )
        return {}, None
    rate_hz = float(without_rounding(rate_hz))
    numbers = [number for by_frame in frames.values() if by_frame for number in (min(by_frame), max(by_frame))] or [0]
    first, last = min(numbers), max(numbers)
    if not TIME_S.holds(first / rate_hz):
        message = f"The first frame has the number {first}, which is at {first / rate_hz:,.0f} s; {TIME_S} are allowed."
        hint = "Number the files from the start of the capture. If the numbers are times, give timestamps."
        problems.append(Problem(session_codes.TIMESTAMPS_START, message, field="frame", hint=hint))
        return {}, None
    times = {
        camera: FrameTimes(np.array(list(by_frame), dtype=np.float64) / rate_hz) for camera, by_frame in frames.items()
    }
    source = TimeSource(
        files=folders,
        start_field="frame",
        rate_field="frame",
        start_hint="Check the numbers of the files: the number divided by the frame rate is the time of the frame.",
        rate_hint="Number the files from the start of the capture; cut a longer capture into several.",
    )
    if times and all(frames.values()):
        problems += clock_problems(times, first / rate_hz, rate_hz, source)
    findings += _sparse_numbers(frames, rate_hz)
    return times, Timebase(first / rate_hz, rate_hz, last - first + 1, first)


def _sparse_numbers(frames: Mapping[str, Collection[int]], rate_hz: float) -> Iterator[Finding]:
    """Report numbers of frames that are nowhere consecutive: frames were left out, or the numbers are times."""
    gaps = [int(np.diff(list(by_frame)).min()) for by_frame in frames.values() if len(by_frame) > 1]
    if gaps and (gap := min(gaps)) > 1:
        message = f"Frame numbers are at least {gap} apart, which is {gap / rate_hz:g} s at {rate_hz:g} Hz."
        hint = (
            f"If the numbers are times, give timestamps. If one frame in {gap} was kept, divide the frame rate and the "
            f"numbers by {gap}."
        )
        yield Finding(FRAMES_DROPPED, message, hint=hint, evidence={"gap_frames": gap})


def times_from_file(
    frames: Mapping[str, Collection[int]], timestamps: Path, problems: list[Problem]
) -> tuple[dict[str, FrameTimes], Timebase | None]:
    """Times from the file of timestamps; output frames run from the first time to the last one.

    They have the rate of the fastest camera, and the first one has the number of the earliest camera's first frame. It
    is at 0 if that frame is at most a frame later: cameras that share a clock need not run in step.
    """
    times: dict[str, FrameTimes] = {}
    read = _read_timestamps(timestamps, frames.keys(), problems)
    if read is None:
        return times, None
    for camera, by_frame in frames.items():
        missing = [number for number in by_frame if number not in read.get(camera, {})]
        if missing:
            message = f"{len(missing)} frames have no time; the first is frame {missing[0]}."
            problems.append(Problem(session_codes.TIMESTAMPS_MISSING, message, file=timestamps.name, camera=camera))
            continue
        time_s = np.array([read[camera][number] for number in by_frame], dtype=np.float64)
        if (np.diff(time_s) <= 0).any():
            first = list(by_frame)[int(np.argmax(np.diff(time_s) <= 0)) + 1]
            message = f"Times must ascend from frame to frame; the time of frame {first} does not."
            problems.append(Problem(session_codes.TIMESTAMPS_ORDER, message, file=timestamps.name, camera=camera))
            continue
        times[camera] = FrameTimes(time_s)
    return times, timebase_of(times, frames, timestamps.name, problems)


def timebase_of(
    times: Mapping[str, FrameTimes], frames: Mapping[str, Collection[int]], file: str, problems: list[Problem]
) -> Timebase | None:
    """Output frames for times of each camera's frames; ``None`` with a problem. See ``times_from_file``.

    ``frames`` are the numbers of each camera's frames, and ``file`` the name of the file of the times.
    """
    # A camera that saw no person may have no frames: some programs list none without people.
    with_frames = [camera_times.time_s for camera_times in times.values() if len(camera_times.time_s)]
    if problems or not with_frames:
        return None
    start_s, first = min(
        (float(times[camera].time_s[0]), min(by_frame)) for camera, by_frame in frames.items() if by_frame
    )
    if start_s > _MAX_START_S:
        problems.append(
            Problem(session_codes.TIMESTAMPS_START, "Times must count from 0.", file=file or None, hint=_START_HINT)
        )
        return None
    rates_hz = [measured_rate_hz(time_s) for time_s in with_frames if len(time_s) > 1]
    rate_hz = max(rates_hz, default=float(DEFAULT_RATE))
    if not FRAME_RATE_HZ.holds(rate_hz, FRAME_RATE_TOLERANCE):
        message = f"By the times the fastest camera has {rate_hz:g} frames a second; {FRAME_RATE_HZ} are allowed."
        hint = (
            "Check that the times are in seconds. Number pictures that are farther apart by seconds: 0, 1, 2 and so on."
        )
        problems.append(Problem(session_codes.FRAME_RATE, message, file=file or None, field="time_s", hint=hint))
    start_s = 0.0 if start_s * rate_hz < 1.0 else start_s
    source = TimeSource(
        files=dict.fromkeys(times, file),
        start_field="time_s",
        rate_field="time_s",
        start_hint="Check the times: seconds since the start of the capture, by a clock that all cameras share.",
        rate_hint="Times are seconds since the start of the capture. Cut a longer capture into several.",
    )
    if all(frames.values()):
        problems += clock_problems(times, start_s, rate_hz, source)
    if problems:
        return None
    end_s = max(float(time_s[-1]) for time_s in with_frames)
    return Timebase(start_s, rate_hz, round((end_s - start_s) * rate_hz) + 1, first)


def _read_timestamps(path: Path, cameras: Iterable[str], problems: list[Problem]) -> dict[str, dict[int, float]] | None:
    """Read times in seconds by camera and frame number; rows of unknown cameras are ignored.

    Returns ``None`` and adds a problem if a row is invalid.
    """
    times_s: dict[str, dict[int, float]] = {camera: {} for camera in cameras}
    name_of = {nfc(camera): camera for camera in times_s}
    try:
        with open_table(path) as table:
            fault = table.fault(_COLUMNS)
            for line, row in () if fault else table.rows:
                _add_row(row, line, times_s, name_of)
    except _LateError as error:
        problems.append(Problem(session_codes.TIMESTAMPS_START, str(error), file=path.name, hint=_START_HINT))
    except _InvalidError as error:
        problems.append(Problem(session_codes.TIMESTAMPS_INVALID, str(error), file=path.name))
    except FileNotFoundError:
        problems.append(Problem(session_codes.TIMESTAMPS_INVALID, "The file does not exist.", file=path.name))
    except (OSError, ValueError, csv.Error):
        problems.append(Problem(session_codes.TIMESTAMPS_INVALID, "The file can't be read as CSV.", file=path.name))
    else:
        if fault is None:
            return times_s
        problems.append(Problem(session_codes.TIMESTAMPS_INVALID, fault, file=path.name))
    return None


def _add_row(
    row: Mapping[str, str], line: int, times_s: Mapping[str, dict[int, float]], name_of: Mapping[str, str]
) -> None:
    camera = name_of.get(nfc(row["camera"]))
    if camera is None:
        return
    try:
        frame, time_s = int(row["frame"]), float(row["time_s"])
    except ValueError:
        raise _InvalidError(f"Line {line} has no valid frame number and time.") from None
    if TIME_S.high < time_s < math.inf:  # usually seconds since 1970
        raise _LateError(f"Times must count from 0; the time in line {line} is not {TIME_S}.")
    if not TIME_S.holds(time_s):
        raise _InvalidError(f"The time in line {line} is not {TIME_S}.")
    if frame in times_s[camera]:
        raise _InvalidError(f"Line {line} gives frame {frame} of {camera} a second time.")
    times_s[camera][frame] = time_s
