"""Clocks of streams: when frames were taken, on the clock of this machine. Standard library only.

All times are in seconds; times of this machine are of ``time.monotonic``.
"""

from typing import Protocol, runtime_checkable

# Largest difference of the rates of two clocks: what quartz of cameras and computers has, with a margin.
_DRIFT = 2e-4
# Difference after which a stream has begun to count again.
_RESTART_S = 10.0
# Lateness from which on frames are left out up to a keyframe, and what that catches up at least.
_TOO_LATE_S, _CAUGHT_UP_S = 1.0, 0.1


@runtime_checkable
class CaptureClock(Protocol):
    """Clock of a stream."""

    def arrive(self, stamp_s: float, now_s: float) -> float:
        """Take the time stamp of what has arrived now; return how late it is."""

    def restart(self, stamp_s: float, now_s: float) -> None:
        """Take what has arrived now for what is not late: the stream counts again."""

    def capture_s(self, stamp_s: float) -> float:
        """Time at which a frame was taken."""


class StreamClock:
    """Clock of a stream whose frames bear times of the camera, such as RTP's.

    A frame arrives some delay after it was taken. The delay varies, by the network and the size of the frame; the times
    of the camera don't. So a frame was taken at its own time plus the smallest delay so far, and jitter of arrival does
    not move it. The smallest delay itself is unknown, and is the same for all frames. As the clocks of camera and
    machine drift apart, the smallest delay is let grow by 0.02 % of the time.
    """

    def __init__(self) -> None:
        self._delay_s: float | None = None
        self._last_s = 0.0

    def arrive(self, stamp_s: float, now_s: float) -> float:
        """Take the time stamp of what has arrived now; return how late it is, compared with the smallest delay."""
        delay_s = now_s - stamp_s
        if self._delay_s is None or abs(delay_s - self._delay_s) > _RESTART_S:
            self._delay_s = delay_s
        self._delay_s = min(delay_s, self._delay_s + _DRIFT * (now_s - self._last_s if self._last_s else 0.0))
        self._last_s = now_s
        return delay_s - self._delay_s

    def restart(self, stamp_s: float, now_s: float) -> None:
        """Begin again with what has arrived now."""
        self._delay_s = now_s - stamp_s

    def capture_s(self, stamp_s: float) -> float:
        """Time at which a frame was taken."""
        return stamp_s + (self._delay_s or 0.0)


class ArrivalClock:
    """Clock of a stream whose frames bear no times: a frame was taken when it arrived."""

    def arrive(self, stamp_s: float, now_s: float) -> float:
        """Return that nothing is late."""
        return 0.0

    def restart(self, stamp_s: float, now_s: float) -> None:
        """Do nothing."""

    def capture_s(self, stamp_s: float) -> float:
        """Time of arrival, which is the stamp."""
        return stamp_s


class PlaybackClock:
    """Clock of a file that is played at its own pace: its first frame is shown at ``start_s``."""

    def __init__(self, start_s: float, first_stamp_s: float) -> None:
        self._shift_s = start_s - first_stamp_s

    def arrive(self, stamp_s: float, now_s: float) -> float:
        """Return how long ago a frame was to be shown; less than 0 for a frame whose time has not come."""
        return now_s - self.capture_s(stamp_s)

    def restart(self, stamp_s: float, now_s: float) -> None:
        """Do nothing: a file keeps its pace."""

    def capture_s(self, stamp_s: float) -> float:
        """Time at which a frame is to be shown."""
        return stamp_s + self._shift_s


class LateFrames:
    """Choice of frames that are left out, up to a keyframe, because this machine decodes too slowly."""

    def __init__(self) -> None:
        self._late_s: float | None = None  # Lateness while frames are left out

    def leaves_out(self, clock: CaptureClock, stamp_s: float, now_s: float, is_keyframe: bool) -> bool:
        """Take what has arrived now; return whether it is to be left out."""
        if self._late_s is not None and not is_keyframe:
            return True
        late_s = clock.arrive(stamp_s, now_s)
        if self._late_s is not None and late_s > max(_TOO_LATE_S, self._late_s - _CAUGHT_UP_S):
            # Frames that are left out are quick; if that is no help, none was waiting: the stream's times have jumped.
            clock.restart(stamp_s, now_s)
            late_s = 0.0
        self._late_s = late_s if late_s > _TOO_LATE_S else None
        return self._late_s is not None
