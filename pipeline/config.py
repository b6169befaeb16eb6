"""What a reconstruction may be asked for."""

from dataclasses import dataclass
from typing import Literal

Method = Literal["tracking"]


@dataclass(frozen=True, slots=True)
class ReconstructionConfig:
    """Choices of one reconstruction; the result depends on the first two only.

    Parameters
    ----------
    method
        How detections become tracks.
    detector
        A network of ``pipeline.detect.models``.
    chunk_frames
        Output frames that one call of the map decodes and detects, in all cameras; by default 100, or fewer where that
        would leave a process idle.
    processes
        How many of these run at once, each with a single-threaded network of its own.
    """

    method: Method = "tracking"
    detector: str = "movenet-multipose"
    chunk_frames: int | None = None
    processes: int = 1
