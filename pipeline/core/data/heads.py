"""Heads in the pictures of a camera: those that a detector saw, and the regions of all heads."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True, slots=True, eq=False)
class SeenHeads:
    """Heads that a detector saw in the frames of a camera, sorted by frame."""

    frame: Int[np.ndarray, " n"]  # The camera's frame number of each head, ascending
    # Centre in x and y, half of the width and half of the height of an ellipse, distorted pixels; NaN for the last two
    # of a head of unknown size
    ellipse_px: Float[np.ndarray, "n 4"]


@dataclass(frozen=True, slots=True, eq=False)
class HeadRegions:
    """Ellipses around the heads in the frames of one camera, sorted by frame; their axes are the picture's."""

    camera: str  # Name of the camera
    size_px: tuple[int, int]  # Width and height of the pictures whose pixels are meant
    # Numbers of the first frame whose heads are known, and of the one after the last
    start_frame: int
    stop_frame: int
    frame: Int[np.ndarray, " n"]  # The camera's frame number of each ellipse, ascending
    # Centre in x and y, half of the width and half of the height, distorted pixels. An ellipse may reach out of the
    # picture, or lie outside of it.
    ellipse_px: Float[np.ndarray, "n 4"]

    def in_frame(self, frame: int, size_px: tuple[int, int]) -> Float[np.ndarray, "here 4"]:
        """Ellipses in a frame, in pixels of a copy of the picture of some size, whose outer edges are the same.

        An ellipse around the whole picture in a frame whose heads are not known.
        """
        if not self.start_frame <= frame < self.stop_frame:
            width, height = size_px
            return np.array([[width / 2, height / 2, width, height]])
        rows = slice(*np.searchsorted(self.frame, [frame, frame + 1]))
        scale = np.array(size_px) / self.size_px
        ellipse_px = self.ellipse_px[rows]
        # Pixel (0, 0) is the centre of the first pixel, and the edge of the picture half a pixel before.
        return np.concatenate([(ellipse_px[:, :2] + 0.5) * scale - 0.5, ellipse_px[:, 2:] * scale], axis=1)
