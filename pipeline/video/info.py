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
    num_repeated
        How many frames have the time of another frame and are left out.
    """

    path: Path
    codec: str
    size_px: tuple[int, int]
    rotation_deg: int
    pts: Int[np.ndarray, " frames"]
    keyframe_pts: Int[np.ndarray, " keyframes"]
    time_s: Float[np.ndarray, " frames"]
    frame_rate_hz: float
    num_repeated: int = 0

    @property
    def stored_size_px(self) -> tuple[int, int]:
        """Width and height of the picture before rotation."""
        width, height = self.size_px
        return (width, height) if self.rotation_deg % 180 == 0 else (height, width)

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return len(self.pts)


def seek_points(keyframe_pts: Int[np.ndarray, " keyframes"], target_pts: int) -> list[int]:
    """Keyframes at which decoding up to ``target_pts`` may begin, the nearest one first.

    The distance to the next one doubles: a few suffice where a container's index leads past some keyframes, or calls
    frames keyframes that are none. Empty if decoding begins at the start of the file.
    """
    last = int(np.searchsorted(keyframe_pts, target_pts, side="right")) - 1
    steps_back = [2**k - 1 for k in range(max(last, 0).bit_length() + 1)]
    return [int(keyframe_pts[last - steps]) for steps in steps_back if last - steps > 0]
