"""The clock that the cameras of a session share, and how it is cut into pieces."""

from collections.abc import Iterable, Mapping

import numpy as np
from jaxtyping import Float

from pipeline.data import FrameTimes, Timebase
from pipeline.video.probe import mean_rate_hz

# A pause of the whole session that is longer is not worked on.
_PAUSE_S = 60.0


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


def recorded_stretches(timebase: Timebase, time_s: Iterable[Float[np.ndarray, " frames"]]) -> tuple[range, ...]:
    """Find the output frames that have to be worked on: all but pauses of more than a minute.

    Parameters
    ----------
    time_s
        Times at which there is anything to see, one array a camera.

    Returns
    -------
        Ranges of output frames in order, one at least. Every frame of ``time_s`` that shows an output frame belongs to
        one of them.
    """
    is_recorded = np.zeros(timebase.num_frames, bool)
    for one_s in time_s:
        nearest = np.rint((one_s - timebase.start_time_s) * timebase.frame_rate_hz)
        is_recorded[np.clip(nearest, 0, timebase.num_frames - 1).astype(np.int64)] = True
    frames = np.flatnonzero(is_recorded)
    if not len(frames):
        return (range(min(1, timebase.num_frames)),)
    last = np.flatnonzero(np.diff(frames) > _PAUSE_S * timebase.frame_rate_hz)
    # One frame more on each side: a time half-way between two output frames belongs to either.
    starts = np.maximum(frames[[0, *(last + 1)]] - 1, 0).tolist()
    stops = np.minimum(frames[[*last, -1]] + 2, timebase.num_frames).tolist()
    return tuple(range(start, stop) for start, stop in zip(starts, stops, strict=True))


def cut_timebase(timebase: Timebase, frames: range) -> Timebase:
    """Some of the output frames, numbered from 0."""
    return Timebase(timebase.time_s(frames.start), timebase.frame_rate_hz, len(frames))


def frames_in(times: FrameTimes, start_s: float, stop_s: float) -> range:
    """Numbers of the frames whose time is in ``[start_s, stop_s)``."""
    first, last = np.searchsorted(times.time_s, [start_s, stop_s], side="left")
    return range(int(first), int(last))
