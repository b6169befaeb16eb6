"""Blurred videos: copies of cameras' videos for players, in which heads are unrecognisable."""

from collections.abc import Callable, Generator
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from pipeline.core.data.heads import HeadRegions
from pipeline.export.privacy.blur import blur_ellipses
from pipeline.video.decode import decode
from pipeline.video.info import VideoInfo
from pipeline.video.playback.h264 import even_size_px
from pipeline.video.playback.proxy_process import LONG_SIDE_PX
from pipeline.video.playback.written import write_pictures


def write_blurred(
    video: VideoInfo,
    time_s: Float[np.ndarray, " frames"],
    frames: range,
    heads: HeadRegions,
    path: Path,
    on_frame: Callable[[], object],
) -> None:
    """Write a small copy of a video, without sound, at the times of its frames as a proxy has them.

    Parameters
    ----------
    time_s
        Times of all frames of the video, ascending; in the copy the first is 0.
    frames
        Frames for which the heads are known. In place of all others, a black picture is shown.
    on_frame
        Called after each frame; an exception from it ends the work.

    Raises
    ------
    InputError
        See ``pipeline.video.decode.decode``.
    """
    size_px = even_size_px(video.size_px, LONG_SIDE_PX)
    black = np.zeros((size_px[1], size_px[0], 3), np.uint8)

    def blurred() -> Generator[tuple[int, UInt8[np.ndarray, "height width 3"]], None, None]:
        if frames.start > 0 or not frames:
            yield 0, black
        if frames:
            with closing(decode(video, frames.start, frames.stop)) as decoded:
                for frame, image_rgb in decoded:
                    picture = cv2.resize(np.ascontiguousarray(image_rgb), size_px, interpolation=cv2.INTER_AREA)
                    yield frame, blur_ellipses(picture, heads.in_frame(frame, size_px))
                    on_frame()
            if frames.stop < len(time_s):
                yield frames.stop, black

    with closing(blurred()) as pictures:
        write_pictures(path, pictures, time_s, size_px)
