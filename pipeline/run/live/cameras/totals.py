"""Totals of a live capture: latencies, frames and states of cameras; their memory does not grow."""

from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np

from pipeline.run.live.outputs.runner import OutputStatus

_BIN_S = 1e-3
_NUM_BINS = 60_000

CameraState = Literal["open", "lost", "ended"]


@dataclass(slots=True)
class CameraTotals:
    """Frames of a camera so far."""

    name: str
    state: CameraState = "open"
    decoded: int = 0  # Frames that came
    detected: int = 0  # Frames in which bodies were detected; the others were dropped
    lost: int = 0  # Times that its stream was lost

    @property
    def dropped(self) -> int:
        """Frames that were not detected."""
        return max(0, self.decoded - self.detected)


class Latencies:
    """Times from capture to people, in bins of a millisecond; the longest one has all beyond a minute."""

    def __init__(self) -> None:
        self._counts = np.zeros(_NUM_BINS + 1, np.int64)

    def add(self, latency_s: float) -> None:
        """Count a latency."""
        self._counts[min(max(int(latency_s / _BIN_S), 0), _NUM_BINS)] += 1

    def percentile_ms(self, percent: float) -> float | None:
        """Percentile in milliseconds; ``None`` without any latency."""
        total = self._counts.cumsum()
        if not total[-1]:
            return None
        return float(np.searchsorted(total, percent / 100 * total[-1]))


@dataclass(slots=True)
class LiveTotals:
    """Counts of a live capture so far."""

    cameras: list[CameraTotals]
    frame_rate_hz: float = 0.0  # Rate of the instants
    duration_s: float = 0.0  # Time since the start
    instants: int = 0
    people: int = 0  # Number of people who appeared
    latencies: Latencies = field(default_factory=Latencies)
    outputs: list[OutputStatus] = field(default_factory=list)

    @property
    def num_frames(self) -> tuple[int, int]:
        """Numbers of frames of all cameras that came, and that were detected."""
        return sum(camera.decoded for camera in self.cameras), sum(camera.detected for camera in self.cameras)

    def document(self) -> dict[str, Any]:
        """Totals as values of JSON."""
        return {
            "duration_s": round(self.duration_s, 3),
            "frame_rate_hz": self.frame_rate_hz,
            "instants": self.instants,
            "people": self.people,
            "latency_ms": {f"p{percent}": self.latencies.percentile_ms(percent) for percent in (50, 95, 99)},
            "cameras": [asdict(camera) | {"dropped": camera.dropped} for camera in self.cameras],
            "outputs": [output.document() for output in self.outputs],
        }
