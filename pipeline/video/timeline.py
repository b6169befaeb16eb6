"""The clock that the cameras of a session share, and how it is cut into pieces."""

from collections.abc import Mapping

import numpy as np

from pipeline.data import FrameTimes, Timebase
from pipeline.video.probe import mean_rate_hz


def session_timebase(times: Mapping[str, FrameTimes]) -> Timebase:
    """Output frames from the earliest first frame to the latest last one, at the rate of the fastest camera."""
    start_s = min(float(one.time_s[0]) for one in times.values())
    end_s = max(float(one.time_s[-1]) for one in times.values())
    rate_hz = max(mean_rate_hz(one.time_s) for one in times.values())
    return Timebase(start_s, rate_hz, round((end_s - start_s) * rate_hz) + 1)


def span_s(timebase: Timebase, start_frame: int, stop_frame: int) -> tuple[float, float]:
    """Range ``[t0, t1)`` of some output frames.

    Borders lie half-way between two output frames, so that rounding never moves a frame; the first range begins at
    minus infinity and the last one ends at infinity, so that consecutive ranges miss no frame and double none.
    """
    return (
        timebase.time_s(start_frame - 0.5) if start_frame > 0 else -np.inf,
        timebase.time_s(stop_frame - 0.5) if stop_frame < timebase.num_frames else np.inf,
    )


def chunk_ranges(timebase: Timebase, chunk_frames: int, wanted: range | None = None) -> list[range]:
    """Ranges of output frames without gap or overlap, which begin at multiples of ``chunk_frames``.

    The last one may be shorter, and of ``wanted`` frames (``None``: all) the first one, too.
    """
    frames = range(timebase.num_frames) if wanted is None else wanted
    starts = range(frames.start - frames.start % chunk_frames, frames.stop, chunk_frames)
    return [range(max(start, frames.start), min(start + chunk_frames, frames.stop)) for start in starts]


def cut_timebase(timebase: Timebase, frames: range) -> Timebase:
    """Some of the output frames, numbered from 0."""
    return Timebase(timebase.time_s(frames.start), timebase.frame_rate_hz, len(frames))


def frames_in(times: FrameTimes, start_s: float, stop_s: float) -> range:
    """Numbers of the frames whose time is in ``[start_s, stop_s)``."""
    first, last = np.searchsorted(times.time_s, [start_s, stop_s], side="left")
    return range(int(first), int(last))
