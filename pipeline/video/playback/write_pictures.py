"""Write pictures as a video that browsers play: apart from ``h264``, whose child processes load no NumPy."""

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import numpy as np
from av.video.frame import VideoFrame
from jaxtyping import Float, UInt8

from pipeline.video.playback.h264 import KEYFRAME_S, TICKS_A_SECOND, add_stream, open_video

# Constant rate factor of x264: thin lines stay sharp.
_CRF = 23


def write_pictures(
    path: Path,
    pictures: Iterable[tuple[int, UInt8[np.ndarray, "height width 3"]]],
    time_s: Float[np.ndarray, " frames"],
    size_px: tuple[int, int],
) -> int:
    """Write pictures at their true times, one at a time.

    ``pictures``: numbers of frames, ascending, and RGB pictures of the size. Frames may be missing. ``time_s``: times
    of all frames, ascending; in the video the first is 0. ``size_px``: width and height, even numbers. Returns number
    of frames that were written. Frames at the time of the frame before, within 1/90000 s, are left out.
    """
    ticks = np.rint((time_s - time_s[0]) * TICKS_A_SECOND).astype(np.int64).tolist()
    rate_hz = (len(ticks) - 1) * TICKS_A_SECOND / max(1, ticks[-1])
    num_frames, last_tick = 0, -1
    with open_video(path) as container:
        stream = add_stream(container, size_px, ticks, max(1, round(KEYFRAME_S * rate_hz)), _CRF)
        for number, image_rgb in pictures:
            if ticks[number] <= last_tick:
                continue
            frame = VideoFrame.from_ndarray(image_rgb, format="rgb24")
            frame.pts, frame.time_base = ticks[number], Fraction(1, TICKS_A_SECOND)
            container.mux(stream.encode(frame))
            num_frames, last_tick = num_frames + 1, ticks[number]
        container.mux(stream.encode(None))
    return num_frames
