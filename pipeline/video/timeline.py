"""Output frames of a session: their rate, times, and ranges for chunks and pauses."""

from collections.abc import Iterable, Mapping

import numpy as np
from jaxtyping import Float, Int

from pipeline.core.data.cameras import FrameTimes, Timebase
from pipeline.core.options.rules import frame_range_problems, require
from pipeline.video.frame_rate import measured_rate_hz

# Longer pauses of all cameras are skipped.
_PAUSE_S = 60.0


def session_timebase(times: Mapping[str, FrameTimes]) -> Timebase:
    """Output frames from the earliest to the latest frame of all cameras, at the rate of the fastest camera.

    Frame times are by camera name, ascending, at least one frame a camera.
    """
    start_s = min(float(camera_times.time_s[0]) for camera_times in times.values())
    end_s = max(float(camera_times.time_s[-1]) for camera_times in times.values())
    rate_hz = max(measured_rate_hz(camera_times.time_s) for camera_times in times.values())
    return Timebase(start_s, rate_hz, round((end_s - start_s) * rate_hz) + 1)


def span_s(timebase: Timebase, start_frame: int, stop_frame: int) -> tuple[float, float]:
    """Time range ``[t0, t1)`` in seconds of a range of output frames.

    Borders lie half-way between two output frames, so that rounding never moves a frame. The first range begins at
    minus infinity and the last range ends at infinity, so that each camera frame is in exactly one range.
    """
    return (
        timebase.time_s(start_frame - 0.5) if start_frame > 0 else -np.inf,
        timebase.time_s(stop_frame - 0.5) if stop_frame < timebase.num_frames else np.inf,
    )


def recorded_stretches(timebase: Timebase, time_s: Iterable[Float[np.ndarray, " frames"]]) -> tuple[range, ...]:
    """Find the output frames to process: all but pauses of more than a minute.

    Frame times are in seconds, an array a camera. The ranges are in order, at least one; the output frame of every time
    is in one of them.
    """
    frames = _recorded_frames(timebase, time_s)
    if not len(frames):
        return (range(min(1, timebase.num_frames)),)
    last = np.flatnonzero(np.diff(frames) > _PAUSE_S * timebase.frame_rate_hz)
    # One more frame on each side: a time half-way between two output frames may be rounded to either.
    starts = np.maximum(frames[[0, *(last + 1)]] - 1, 0).tolist()
    stops = np.minimum(frames[[*last, -1]] + 2, timebase.num_frames).tolist()
    return tuple(range(start, stop) for start, stop in zip(starts, stops, strict=True))


def num_recorded(timebase: Timebase, time_s: Iterable[Float[np.ndarray, " frames"]]) -> int:
    """Count the output frames at which a camera took a frame; times are the same as for ``recorded_stretches``."""
    return len(_recorded_frames(timebase, time_s))


def _recorded_frames(
    timebase: Timebase, time_s: Iterable[Float[np.ndarray, " frames"]]
) -> Int[np.ndarray, " recorded"]:
    is_recorded = np.zeros(timebase.num_frames, bool)
    for camera_time_s in time_s:
        nearest = np.rint((camera_time_s - timebase.start_time_s) * timebase.frame_rate_hz)
        is_recorded[np.clip(nearest, 0, timebase.num_frames - 1).astype(np.int64)] = True
    return np.flatnonzero(is_recorded)


def require_frames(whole: Timebase, frames: range) -> None:
    """Require that a session has a range of output frames.

    Raises ``InputError`` if it is empty, or not within the session's frames.
    """
    require(frame_range_problems(frames.start, frames.stop, whole.num_frames))


def cut_timebase(timebase: Timebase, frames: range) -> Timebase:
    """Timebase of a range of output frames, which are numbered from 0."""
    first = timebase.first_source_frame + frames.start
    return Timebase(timebase.time_s(frames.start), timebase.frame_rate_hz, len(frames), first)


def frames_in(times: FrameTimes, start_s: float, stop_s: float) -> range:
    """Numbers of the camera frames with a time in ``[start_s, stop_s)``."""
    first, last = np.searchsorted(times.time_s, [start_s, stop_s], side="left")
    return range(int(first), int(last))
