"""Limits of a session's clock: number of output frames, duration, overlap of cameras; and videos in slow motion.

The number of output frames is the session's duration times the rate of its fastest camera. Without limits, one wrong
offset or one damaged timestamp would give billions of output frames.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pipeline.core.data.cameras import FrameTimes
from pipeline.core.errors import Problem
from pipeline.core.findings import Finding
from pipeline.core.options.config import MAX_OUTPUT_FRAMES
from pipeline.core.parsing import DURATION_S, FRAME_RATE_HZ, FRAME_RATE_TOLERANCE
from pipeline.core.problems.code_group import Code
from pipeline.core.problems.finding_codes import SLOW_MOTION
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


# 50 in 25 frames a second up to 1000 in 25: factors of cameras and phones.
_FACTORS = (2, 4, 5, 8, 10, 16, 20, 32, 40)
# Cameras that are started and stopped by hand differ in length by a second in twenty.
_TOLERANCE = 0.05


def slow_motion(times: Mapping[str, FrameTimes], files: Mapping[str, str]) -> list[Finding]:
    """Name videos that were filmed at a higher rate than they are stored at.

    ``times``: frame times of all cameras, by camera name. ``files``: names of the videos whose rates are not stated, by
    camera name. Returns a finding of each such video with both rates, if more cameras than not agree on the length.
    """
    rates_hz = {name: measured_rate_hz(of_camera.time_s) for name, of_camera in times.items()}
    lengths_s = {name: len(of_camera.time_s) / rates_hz[name] for name, of_camera in times.items()}
    usual_s = min(lengths_s.values())
    alike_s = [length_s for length_s in lengths_s.values() if length_s <= (1 + 2 * _TOLERANCE) * usual_s]
    usual_s = float(np.median(alike_s))
    if 2 * len(alike_s) < len(lengths_s):
        return []
    findings = []
    for name, file in files.items():
        ratio = lengths_s[name] / usual_s
        factor = min(_FACTORS, key=lambda factor: abs(ratio / factor - 1))
        filmed_hz = factor * rates_hz[name]
        if abs(ratio / factor - 1) > _TOLERANCE or not FRAME_RATE_HZ.holds(filmed_hz):
            continue
        message = (
            f"{file} lasts {lengths_s[name]:.1f} s, {factor} times as long as the others ({usual_s:.1f} s). It seems "
            f"to be slow motion: filmed at {filmed_hz:.6g} Hz, stored at {rates_hz[name]:.6g} Hz."
        )
        hint = (
            f"State the rate at which it was filmed: --rate {name}={filmed_hz:.6g}, or rate of the camera in the "
            "manifest and on the page. If the camera only ran longer, nothing is to be done."
        )
        evidence = {"file": file, "factor": factor, "filmed_hz": filmed_hz, "stored_hz": rates_hz[name]}
        findings.append(Finding(SLOW_MOTION, message, name, hint=hint, evidence=evidence))
    return findings
