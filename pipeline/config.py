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
        Output frames of one chunk: what is decoded and detected as one piece, of one camera.
    processes
        How many chunks are worked on at once, each with a single-threaded network of its own.
    """

    method: Method = "tracking"
    detector: str = "movenet-multipose"
    chunk_frames: int = 100
    processes: int = 1
