"""Frames of all cameras in time order: those that wait for earlier ones, and those that came too late."""

import bisect
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, UInt8

from pipeline.association.tracking.kernels.observation_kernels import clear_unfound
from pipeline.association.tracking.observations import within_view
from pipeline.core.data.cameras import Camera
from pipeline.geometry.undistortion import undistort_px
from pipeline.run.live.records import LiveCounts
from pipeline.run.live.settings import LiveSettings

# Most frames that wait; with more, the earliest are processed before their time. At 28 cameras of 60 Hz it is 2.4 s.
_MOST_WAITING = 4096


@dataclass(frozen=True, slots=True, eq=False)
class LiveFrame:
    """Detections in a camera's frame."""

    time_s: float
    camera: int  # Position of the camera
    ideal_px: Float[np.ndarray, "people joints 2"]  # Undistorted joints, NaN where a joint was not found
    score: Float[np.ndarray, "people joints"]  # The detector's confidence, 0 where a joint was not found
    # Colours of the people's clothes, like ``detection.appearance``; ``None``: not measured
    colour: UInt8[np.ndarray, "people parts bins"] | None = None

    @property
    def colours(self) -> Sequence[UInt8[np.ndarray, "parts bins"] | None]:
        """Colours of each person."""
        return [None] * len(self.score) if self.colour is None else list(self.colour)


def make_frame(
    camera: Camera,
    number: int,
    time_s: float,
    points_px: Float[np.ndarray, "people joints 2"],
    score: Float[np.ndarray, "people joints"],
    colour: UInt8[np.ndarray, "people parts bins"] | None = None,
) -> LiveFrame:
    """Frame of a camera from joints in pixels of the full image, as ``tracking.observations`` prepares them."""
    seen_px, score = np.array(within_view(camera, points_px), order="C"), np.array(score, order="C")
    clear_unfound(seen_px, score)
    ideal_px = seen_px if camera.is_ideal else np.ascontiguousarray(undistort_px(camera, seen_px))
    return LiveFrame(time_s, number, ideal_px, score, colour)


class FrameQueue:
    """Frames that wait until no earlier frame is expected."""

    def __init__(self, num_cameras: int, settings: LiveSettings) -> None:
        self._settings = settings
        self._waiting: list[LiveFrame] = []
        self._latest_s = np.full(num_cameras, -np.inf)  # time of each camera's latest frame
        # Cameras that are waited for: those that were silent while a frame waited for the window are not.
        self._is_heard = np.ones(num_cameras, bool)
        self.newest_s = -np.inf
        self.settled_s = -np.inf
        """Time up to which all frames were released: a frame that is not behind it comes too late."""
        self.counts = LiveCounts()

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, frame: LiveFrame) -> None:
        """Take a frame, unless it comes too late, or the camera has sent another one of the same time."""
        self._is_heard[frame.camera] = True
        place = bisect.bisect_left(self._waiting, _order(frame), key=_order)
        is_known = place < len(self._waiting) and _order(self._waiting[place]) == _order(frame)
        is_late = frame.time_s < self.newest_s
        self._latest_s[frame.camera] = max(self._latest_s[frame.camera], frame.time_s)
        self.newest_s = max(self.newest_s, frame.time_s)
        if frame.time_s <= self.settled_s or is_known:
            self.counts = replace(self.counts, dropped=self.counts.dropped + 1)
            return
        self.counts = replace(self.counts, taken=self.counts.taken + 1, late=self.counts.late + is_late)
        self._waiting.insert(place, frame)

    def release(self) -> list[LiveFrame]:
        """Remove the frames that need not wait any longer; frames of the same time are in order of the cameras."""
        settled_s = self.newest_s - self._settings.window_s
        if self._settings.is_ordered:
            if self._waiting and self._waiting[0].time_s < settled_s:
                self._is_heard &= self._latest_s >= settled_s
            settled_s = max(settled_s, float(self._latest_s[self._is_heard].min()))
        if len(self._waiting) > _MOST_WAITING:
            settled_s = max(settled_s, self._waiting[-_MOST_WAITING - 1].time_s)
        return self._up_to(settled_s)

    def release_all(self) -> list[LiveFrame]:
        """Remove all frames."""
        return self._up_to(self.newest_s)

    def _up_to(self, time_s: float) -> list[LiveFrame]:
        self.settled_s = max(self.settled_s, time_s + self._settings.same_instant_s)
        stop = bisect.bisect_right(self._waiting, self.settled_s, key=lambda frame: frame.time_s)
        released, self._waiting = self._waiting[:stop], self._waiting[stop:]
        return released


def _order(frame: LiveFrame) -> tuple[float, int]:
    return frame.time_s, frame.camera
