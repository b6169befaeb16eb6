"""Limits of a session's clock: a number of output frames that every stage bears, and cameras that overlap.

The output frames of a session are its duration times the rate of its fastest camera. One wrong offset, or one damaged
time in a video, would make billions of them.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from pipeline.capture.quantities import DURATION_S, FRAME_RATE_HZ, FRAME_RATE_TOLERANCE
from pipeline.config import MAX_OUTPUT_FRAMES
from pipeline.data import FrameTimes
from pipeline.errors import Problem
from pipeline.video.frame_rate import measured_rate_hz


@dataclass(frozen=True, slots=True)
class TimeSource:
    """Source of a session's frame times, which problems name.

    Parameters
    ----------
    files
        Name of the file that holds a camera's times, by camera name.
    start_field, rate_field
        Fields by which a person states when a camera began, and how fast it is.
    start_hint, rate_hint
        What to do if a camera's start, or its rate, is wrong.
    """

    files: Mapping[str, str]
    start_field: str
    rate_field: str
    start_hint: str
    rate_hint: str


def clock_problems(
    times: Mapping[str, FrameTimes], start_s: float, rate_hz: float, source: TimeSource
) -> list[Problem]:
    """Find everything that is wrong with a session's clock.

    Parameters
    ----------
    times
        Frame times by camera name, ascending, at least one frame a camera.
    start_s
        Time of the first output frame.
    rate_hz
        Rate of the output frames. The number of frames is checked if the rate itself is a frame rate.
    source
        Where the times come from.
    """
    of_cameras = [*_overlap_problems(times, source), *_length_problems(times, source)]
    return of_cameras or list(_session_problems(times, start_s, rate_hz, source))


def _overlap_problems(times: Mapping[str, FrameTimes], source: TimeSource) -> Iterator[Problem]:
    """Cameras that recorded nothing while another camera did."""
    spans_s = {name: (float(one.time_s[0]), float(one.time_s[-1])) for name, one in times.items()}
    for name, (begin_s, end_s) in spans_s.items():
        others_s = (span_s for other, span_s in spans_s.items() if other != name)
        if not any(begin_s <= other_end_s and other_begin_s <= end_s for other_begin_s, other_end_s in others_s):
            yield Problem(
                "no_overlap",
                f"The camera recorded from {begin_s:.3f} to {end_s:.3f} s, when no other camera did.",
                file=source.files[name],
                camera=name,
                field=source.start_field,
                hint=source.start_hint,
            )


def _length_problems(times: Mapping[str, FrameTimes], source: TimeSource) -> Iterator[Problem]:
    """Cameras that recorded for longer than a session lasts."""
    for name, one in times.items():
        length_s = float(one.time_s[-1] - one.time_s[0])
        if not DURATION_S.holds(length_s):
            yield Problem(
                "session_too_long",
                f"The camera recorded for {length_s:,.2f} s; at most {DURATION_S.high:,} s are taken.",
                file=source.files[name],
                camera=name,
                field=source.rate_field,
                hint=source.rate_hint,
            )


def _session_problems(
    times: Mapping[str, FrameTimes], start_s: float, rate_hz: float, source: TimeSource
) -> Iterator[Problem]:
    """A session that lasts too long though each of its cameras does not, or that has too many output frames."""
    last = max(times, key=lambda name: float(times[name].time_s[-1]))
    duration_s = float(times[last].time_s[-1]) - start_s
    num_frames = duration_s * rate_hz + 1
    if not DURATION_S.holds(duration_s):
        yield Problem(
            "session_too_long",
            f"The camera's last frame is {duration_s:,.2f} s after the session's first one; at most "
            f"{DURATION_S.high:,} s are taken.",
            file=source.files[last],
            camera=last,
            field=source.start_field,
            hint=source.start_hint,
        )
    elif FRAME_RATE_HZ.holds(rate_hz, FRAME_RATE_TOLERANCE) and num_frames > MAX_OUTPUT_FRAMES + 0.5:
        fastest = max(times, key=lambda name: measured_rate_hz(times[name].time_s))
        yield Problem(
            "too_many_frames",
            f"The session lasts {duration_s:,.2f} s, and its fastest camera takes {rate_hz:g} frames a second: that "
            f"is {num_frames:,.0f} output frames; at most {MAX_OUTPUT_FRAMES:,} are taken.",
            file=source.files[fastest],
            camera=fastest,
            field=source.rate_field,
            hint=source.rate_hint,
        )
