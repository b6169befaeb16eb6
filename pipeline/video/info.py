"""Properties of a video, read before its frames are decoded."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.core.errors import Problem


@dataclass(frozen=True, slots=True)
class Timecode:
    """Timecode of the first frame."""

    time_s: float  # Time since midnight
    rate_hz: float  # Frames a second of the timecode; the video may have a multiple of it
    is_drop_frame: bool = False  # True if numbers are left out, so that 29.97 frames a second keep up with the day

    @property
    def day_s(self) -> float:
        """Time after which the timecode begins again: a day has its number of frames (SMPTE 12M).

        It is 86,400 s at whole rates, 86,486.4 s at 29.97 frames a second, and 86,399.9136 s with drop-frame.
        """
        frames_a_second = round(self.rate_hz)
        # Two numbers in each minute but every tenth, four at 59.94 frames a second.
        num_dropped = 24 * 54 * 2 * frames_a_second // 30 if self.is_drop_frame else 0
        return (86_400 * frames_a_second - num_dropped) / self.rate_hz


@dataclass(frozen=True, slots=True, eq=False)
class VideoInfo:
    """Properties of a usable video file."""

    path: Path  # The file
    codec: str  # FFmpeg's name of the codec
    size_px: tuple[int, int]  # Width and height of the picture as shown: with square pixels, after rotation
    rotation_deg: int  # Counterclockwise turn of the decoded picture for display, after ``is_mirrored``: 0 to 270
    # Presentation timestamps of all frames, in ticks of the stream's time base, ascending
    pts: NDArray[np.int64]
    keyframe_pts: NDArray[np.int64]  # Timestamps of the keyframes, at which decoding can start
    time_s: NDArray[np.float64]  # Times of the frames in seconds; the first is 0
    frame_rate_hz: float  # Rate of ``frame_rate.measured_rate``
    num_repeated: int = 0  # Number of frames that are left out because they have the timestamp of another frame
    is_mirrored: bool = False  # True if left and right of the decoded picture are exchanged for display
    stored_width_px: int | None = None  # Width of the stored picture if its pixels are not square; ``None``: they are
    timecode: Timecode | None = None  # Timecode of the first frame; ``None``: the file has none
    # Time of creation that the file states, in seconds since 1970; ``None``: it states none
    created_s: float | None = None
    warnings: tuple[Problem, ...] = ()  # Facts about the file for users, each with a stable code
    # Media type as which browsers play the file; ``None`` if some don't, see ``pipeline.video.probe``
    browser_media_type: str | None = None
    media_start_s: float = 0.0  # Time of the first frame on the clock of the file, which players show
    tick_s: float = 1.0  # Duration of a tick of the stream's time base, in seconds
    # Files of a recording in several, in order; empty for one file. The path is the first file's, and the timestamps
    # are numbered through: ``joined`` makes them, and ``decode`` knows of them.
    parts: tuple["VideoInfo", ...] = ()

    @property
    def paths(self) -> tuple[Path, ...]:
        """Paths of all files."""
        return tuple(part.path for part in self.parts) or (self.path,)

    @property
    def unrotated_size_px(self) -> tuple[int, int]:
        """Width and height of the picture with square pixels, before rotation."""
        width, height = self.size_px
        return (width, height) if self.rotation_deg % 180 == 0 else (height, width)

    @property
    def stored_size_px(self) -> tuple[int, int]:
        """Width and height of the stored picture, before pixels become square and before rotation."""
        width, height = self.unrotated_size_px
        return self.stored_width_px or width, height

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return len(self.pts)


def seek_points(keyframe_pts: NDArray[np.int64], target_pts: int) -> list[int]:
    """Timestamps of keyframes at which decoding up to ``target_pts`` may begin, the nearest first.

    The distance doubles from keyframe to keyframe. So a few attempts suffice if a container's index skips keyframes or
    marks other frames as keyframes. Empty if decoding begins at the start of the file.
    """
    last = int(np.searchsorted(keyframe_pts, target_pts, side="right")) - 1
    steps_back = [2**k - 1 for k in range(max(last, 0).bit_length() + 1)]
    return [int(keyframe_pts[last - steps]) for steps in steps_back if last - steps > 0]
