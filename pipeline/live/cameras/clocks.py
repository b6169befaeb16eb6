"""Clocks of streams: when frames were taken, on the clock of this machine. Standard library only.

All times are in seconds; those of this machine are of ``time.monotonic``.
"""

from typing import Protocol

# Largest difference of the rates of two clocks: what quartz of cameras and computers has, with a margin.
_DRIFT = 2e-4
# Difference after which a stream has begun to count anew.
_RESTART_S = 10.0


class CaptureClock(Protocol):
    """Clock of a stream."""

    def arrive(self, stamp_s: float, now_s: float) -> float:
        """Take the time stamp of what has arrived now; return how late it is."""

    def capture_s(self, stamp_s: float) -> float:
        """Time at which a frame was taken."""


class StreamClock:
    """Clock of a stream whose frames bear times of the camera, such as those of RTP.

    A frame arrives some delay after it was taken. The delay varies, by the network and the size of the frame; the times
    of the camera don't. So a frame was taken at its own time plus the smallest delay so far, and jitter of arrival does
    not move it. What the smallest delay holds is unknown, and is the same for all frames. As the clocks of camera and
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

    def capture_s(self, stamp_s: float) -> float:
        """Time at which a frame was taken."""
        return stamp_s + (self._delay_s or 0.0)


class ArrivalClock:
    """Clock of a stream whose frames bear no times: a frame was taken when it arrived."""

    def arrive(self, stamp_s: float, now_s: float) -> float:
        """Return that nothing is late."""
        return 0.0

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

    def capture_s(self, stamp_s: float) -> float:
        """Time at which a frame is to be shown."""
        return stamp_s + self._shift_s
