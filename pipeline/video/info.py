"""What is known of a video before its frames are decoded."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True, slots=True, eq=False)
class VideoInfo:
    """A video file whose frames can be told apart and found.

    Parameters
    ----------
    path
        The file.
    codec
        FFmpeg's name of the codec.
    size_px
        Width and height of the picture after rotation.
    rotation_deg
        By how much the decoded picture is turned counterclockwise before it is shown: 0, 90, 180 or 270.
    pts
        Presentation timestamps of all frames in units of the stream's time base, ascending.
    keyframe_pts
        Those of the frames at which decoding can start.
    time_s
        Times of the frames since the first.
    frame_rate_hz
        Mean rate over the intervals that are not gaps.
    """

    path: Path
    codec: str
    size_px: tuple[int, int]
    rotation_deg: int
    pts: Int[np.ndarray, " frames"]
    keyframe_pts: Int[np.ndarray, " keyframes"]
    time_s: Float[np.ndarray, " frames"]
    frame_rate_hz: float

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return len(self.pts)
