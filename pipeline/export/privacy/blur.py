"""Pictures in which some ellipses are unrecognisable: means of large cells take their place, and are blurred.

A blur alone can be undone as far as the picture's numbers are exact. Of a head a few means are left here, from which no
face comes back.
"""

import math
from collections.abc import Callable, Generator
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from pipeline.core.data.detections import HeadRegions
from pipeline.video.decode import decode
from pipeline.video.info import VideoInfo
from pipeline.video.playback.h264 import even_size_px
from pipeline.video.playback.proxy import LONG_SIDE_PX
from pipeline.video.playback.write_pictures import write_pictures

CELLS = 4
"""Number of cells along the shorter axis of an ellipse; of the longer axis of narrow ellipses there are more."""

_MIN_CELL_PX = 2
# Standard deviation of the blur over the cells, in cells.
_BLUR_CELLS = 0.4


def blur_ellipses(
    image_rgb: UInt8[np.ndarray, "height width 3"], ellipse_px: Float[np.ndarray, "ellipses 4"]
) -> UInt8[np.ndarray, "height width 3"]:
    """Copy of a picture with blurred ellipses.

    ``ellipse_px``: centre in x and y, half of the width and half of the height of each ellipse, in pixels. Regions
    outside of the picture are ignored.
    """
    image = np.ascontiguousarray(image_rgb).copy()
    height, width = image.shape[:2]
    for x_px, y_px, half_width_px, half_height_px in ellipse_px.tolist():
        left, right = (_clipped(x_px + side * half_width_px, width) for side in (-1, 1))
        top, bottom = (_clipped(y_px + side * half_height_px, height) for side in (-1, 1))
        if left >= right or top >= bottom:
            continue
        patch = image[top:bottom, left:right]
        cell_px = max(_MIN_CELL_PX, 2 * min(half_width_px, half_height_px) / CELLS)
        columns = (np.arange(left, right) - x_px) / half_width_px
        rows = (np.arange(top, bottom) - y_px) / half_height_px
        is_inside = rows[:, None] ** 2 + columns[None, :] ** 2 <= 1.0
        patch[is_inside] = _pixelated(patch, cell_px)[is_inside]
    return image


def _clipped(place_px: float, side_px: int) -> int:
    """Whole pixel at or before a place, within the picture."""
    return math.floor(min(max(place_px + 0.5, 0.0), float(side_px)))


def _pixelated(patch: UInt8[np.ndarray, "height width 3"], cell_px: float) -> UInt8[np.ndarray, "height width 3"]:
    """Means of cells of about a size, blurred into each other."""
    height, width = patch.shape[:2]
    num_cells = (max(1, math.floor(width / cell_px)), max(1, math.floor(height / cell_px)))
    cells = cv2.resize(patch, num_cells, interpolation=cv2.INTER_AREA)
    coarse = cv2.resize(cells, (width, height), interpolation=cv2.INTER_NEAREST)
    return np.asarray(cv2.GaussianBlur(coarse, (0, 0), _BLUR_CELLS * min(cell_px, max(width, height))), np.uint8)


def write_blurred(
    video: VideoInfo,
    time_s: Float[np.ndarray, " frames"],
    frames: range,
    heads: HeadRegions,
    path: Path,
    on_frame: Callable[[], object],
) -> None:
    """Write a small copy of a video, without sound, at the times of its frames as a proxy has them.

    ``time_s``: times of all frames of the video, ascending; in the copy the first is 0. ``frames``: frames for which
    the heads are known. In place of all others, a black picture is shown. ``on_frame``: called after each frame; an
    exception from it ends the work. Raises ``InputError``: see ``pipeline.video.decode.decode``.
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
