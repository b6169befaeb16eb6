"""Choice of the frames that are detected, where cameras send more than there is time for."""

import math
from collections.abc import Sequence

# Part of a camera's period by which frames of one instant may be apart.
_APART = 0.25
# Least rate at which people can be followed.
_MIN_RATE_HZ = 5.0
# Share of the wanted frames below which the machine is behind, and seconds of that before fewer are wanted; chosen.
_KEPT_UP, _MAX_BEHIND_S = 0.85, 2
# Seconds of keeping up before more frames are tried again: twice as many each time that fewer are wanted; chosen.
_PATIENCE_S, _MAX_PATIENCE_S = 20, 640


class DetectionPace:
    """Choice of the frames that are detected.

    Of each camera the newest frame counts, so that no lag grows, and the camera whose last detected frame is the oldest
    is the next one. Where it is known that only a part of the frames can be detected, time is cut into slots of several
    frames. Of each camera the first frame in a slot is wanted, so that all are of about the same instant; one that
    misses it waits for the next slot.

    If the machine becomes slower, slots become longer; ``judge`` decides it.

    ``start_s``: time at which the slots begin. ``rate_hz``: rate of the fastest camera. ``every``: frames of that
    camera in a slot; 1: every frame is wanted.
    """

    def __init__(self, num_cameras: int, start_s: float, rate_hz: float, every: int) -> None:
        self._start_s, self._rate_hz, self.every, self._least = start_s, rate_hz, every, every
        self._behind_s = self._kept_up_s = self._patience_s = 0
        self._newest_s: list[float | None] = [None] * num_cameras
        self._taken_s, self._announced_s = [-math.inf] * num_cameras, [-math.inf] * num_cameras
        self._is_first = [False] * num_cameras

    def announce(self, camera: int, time_s: float) -> None:
        """Take notice of a new frame."""
        self._newest_s[camera] = time_s
        self._is_first[camera] = self._slot(time_s) > self._slot(self._announced_s[camera])
        self._announced_s[camera] = time_s

    def choose(self, free: Sequence[int]) -> int | None:
        """Return the camera whose newest frame is to be detected next, of those given, and take it; ``None``: none."""
        wanted = [camera for camera in free if self._is_wanted(camera)]
        if not wanted:
            return None
        chosen = min(wanted, key=lambda camera: self._taken_s[camera])
        self._taken_s[chosen] = self._newest_s[chosen] or 0.0
        self._newest_s[chosen] = None
        return chosen

    def take(self, camera: int, time_s: float) -> None:
        """Take notice of the frame that has come; it may be newer than the chosen one."""
        self._taken_s[camera] = time_s

    def judge(self, num_decoded: int, num_detected: int) -> bool:
        """Take notice of the frames of a second; ``True``: another part of the frames is wanted from now on.

        Cameras of a machine that is behind have few instants in common, so that hardly anything can be triangulated.
        """
        if num_detected < _KEPT_UP * num_decoded / self.every:
            self._behind_s, self._kept_up_s = self._behind_s + 1, 0
        else:
            self._behind_s, self._kept_up_s = 0, self._kept_up_s + 1
        if self._behind_s >= _MAX_BEHIND_S and self.every < int(self._rate_hz / _MIN_RATE_HZ):
            self.every += 1
            self._patience_s = min(2 * self._patience_s or _PATIENCE_S, _MAX_PATIENCE_S)
        elif self._kept_up_s >= self._patience_s and self.every > self._least:
            self.every -= 1
        else:
            return False
        self._behind_s = self._kept_up_s = 0
        return True

    def _is_wanted(self, camera: int) -> bool:
        newest_s = self._newest_s[camera]
        if newest_s is None or newest_s <= self._taken_s[camera]:
            return False
        return self.every == 1 or (self._is_first[camera] and self._slot(newest_s) > self._slot(self._taken_s[camera]))

    def _slot(self, time_s: float) -> float:
        if math.isinf(time_s):
            return time_s
        return math.floor(((time_s - self._start_s) * self._rate_hz + _APART) / self.every)


def frames_in_slot(rate_hz: float, num_cameras: int, detections_hz: float) -> int:
    """Frames of a camera of which one can be detected; of a slower machine more, but people need five a second.

    ``rate_hz``: rate of the fastest camera. ``detections_hz``: pictures that can be detected in a second.

    >>> frames_in_slot(25.0, 4, 110.0), frames_in_slot(25.0, 4, 60.0)
    (1, 2)
    """
    return max(1, min(math.ceil(rate_hz * num_cameras / detections_hz - 1e-6), int(rate_hz / _MIN_RATE_HZ)))
