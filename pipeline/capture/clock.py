"""Limits of a session's clock: number of output frames, duration, and overlap of cameras.

The number of output frames is the session's duration times the rate of its fastest camera. Without limits, one wrong
offset or one damaged timestamp would give billions of output frames.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

from pipeline.core.data.cameras import FrameTimes
from pipeline.core.errors import Problem
from pipeline.core.options.config import MAX_OUTPUT_FRAMES
from pipeline.core.parsing import DURATION_S, FRAME_RATE_HZ, FRAME_RATE_TOLERANCE
from pipeline.core.problems.code_group import Code
from pipeline.core.problems.session_codes import NO_OVERLAP, SESSION_TOO_LONG, TOO_MANY_FRAMES
from pipeline.video.frame_rate import measured_rate_hz


@dataclass(frozen=True, slots=True)
class TimeSource:
    """Source of a session's frame times, for problems."""

    files: Mapping[str, str]  # Name of the file with a camera's frame times, by camera name
    # Input fields for the start and for the rate of a camera
    start_field: str
    rate_field: str
    # Remedy if a camera's start, or its rate, is wrong
    start_hint: str
    rate_hint: str


def clock_problems(
    times: Mapping[str, FrameTimes], start_s: float, rate_hz: float, source: TimeSource
) -> list[Problem]:
    """Find all problems of a session's clock.

    ``times``: frame times by camera name, ascending, at least one frame a camera. ``start_s``: time of the first output
    frame in seconds. ``rate_hz``: rate of the output frames. The number of frames is checked only if the rate is within
    its own limits.
    """
    of_cameras = [*_overlap_problems(times, source), *_length_problems(times, source)]
    return of_cameras or list(_session_problems(times, start_s, rate_hz, source))


def _overlap_problems(times: Mapping[str, FrameTimes], source: TimeSource) -> Iterator[Problem]:
    """Report cameras that recorded at no time together with another camera, if there is another one."""
    spans_s = {
        name: (float(camera_times.time_s[0]), float(camera_times.time_s[-1])) for name, camera_times in times.items()
    }
    for name, (begin_s, end_s) in spans_s.items():
        others_s = [span_s for other, span_s in spans_s.items() if other != name]
        overlaps = any(begin_s <= other_end_s and other_begin_s <= end_s for other_begin_s, other_end_s in others_s)
        if others_s and not overlaps:
            message = f"The camera recorded from {begin_s:.3f} to {end_s:.3f} s; no other camera recorded at that time."
            yield _camera_problem(NO_OVERLAP, message, name, source, "start")


def _length_problems(times: Mapping[str, FrameTimes], source: TimeSource) -> Iterator[Problem]:
    """Report cameras that recorded for longer than a session may last."""
    for name, camera_times in times.items():
        length_s = float(camera_times.time_s[-1] - camera_times.time_s[0])
        if not DURATION_S.holds(length_s):
            message = f"The camera recorded for {length_s:,.2f} s; at most {DURATION_S.high:,} s are allowed."
            yield _camera_problem(SESSION_TOO_LONG, message, name, source, "rate")


def _session_problems(
    times: Mapping[str, FrameTimes], start_s: float, rate_hz: float, source: TimeSource
) -> Iterator[Problem]:
    """Report a session that lasts too long, although each of its cameras does not, or has too many output frames."""
    last = max(times, key=lambda name: float(times[name].time_s[-1]))
    duration_s = float(times[last].time_s[-1]) - start_s
    num_frames = duration_s * rate_hz + 1
    if not DURATION_S.holds(duration_s):
        message = (
            f"The camera's last frame is {duration_s:,.2f} s after the capture's first one; at most "
            f"{DURATION_S.high:,} s are allowed."
        )
        yield _camera_problem(SESSION_TOO_LONG, message, last, source, "start")
    elif FRAME_RATE_HZ.holds(rate_hz, FRAME_RATE_TOLERANCE) and num_frames > MAX_OUTPUT_FRAMES + 0.5:
        fastest = max(times, key=lambda name: measured_rate_hz(times[name].time_s))
        message = (
            f"The capture lasts {duration_s:,.2f} s, and its fastest camera has {rate_hz:g} frames a second: that "
            f"is {num_frames:,.0f} output frames; at most {MAX_OUTPUT_FRAMES:,} are allowed."
        )
        yield _camera_problem(TOO_MANY_FRAMES, message, fastest, source, "rate")


def _camera_problem(
    code: Code, message: str, camera: str, source: TimeSource, quantity: Literal["start", "rate"]
) -> Problem:
    """Report a problem of a camera, with the input field and the remedy of its start or of its rate."""
    field, hint = {
        "start": (source.start_field, source.start_hint),
        "rate": (source.rate_field, source.rate_hint),
    }[quantity]
    return Problem(code, message, file=source.files[camera], camera=camera, field=field, hint=hint)
