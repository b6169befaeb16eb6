"""Views of a board: its corners in the pictures of a camera, as arrays, their choice, and their coverage."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from pipeline.core.data.arrays import read_only

# Views with edges wider than this multiple of the median are blurred by motion or out of focus.
_MAX_BLUR = 1.5
# Cells of the picture across and down, and the drawing of them.
_CELLS = (8, 6)
_WIDTH = 480
_MAX_DOTS = 4000


@dataclass(frozen=True, slots=True, eq=False)
class BoardViews:
    """Corners of a board in pictures of one camera."""

    camera: str  # Name of the camera
    size_px: tuple[int, int]  # Width and height of the pictures
    # Time of each picture on the session's clock; NaN for photographs, which have none
    time_s: Float[np.ndarray, " views"]
    # Pixels of each corner by number; NaN where a corner was not found
    corners_px: Float[np.ndarray, "views corners 2"]
    sharpness_px: Float[np.ndarray, " views"]  # Width of the edges of the board: smaller is sharper
    num_pictures: int  # Number of pictures that were looked at, with and without the board
    num_mirrored: int = 0  # Number of pictures in which the board is mirrored
    num_exchanged: int = 0  # Number of pictures that show a board with the numbers of columns and rows exchanged

    def __len__(self) -> int:
        """Number of views."""
        return len(self.time_s)

    def select(self, chosen: Sequence[int] | np.ndarray) -> "BoardViews":
        """Views with the given numbers."""
        index = np.asarray(chosen, int)
        return BoardViews(
            self.camera,
            self.size_px,
            read_only(self.time_s[index]),
            read_only(self.corners_px[index]),
            read_only(self.sharpness_px[index]),
            self.num_pictures,
            self.num_mirrored,
            self.num_exchanged,
        )


def choose_views(views: BoardViews, most: int) -> Int[np.ndarray, " chosen"]:
    """Numbers of at most ``most`` views, ascending: farthest-point sampling of the sharp ones.

    Two views are far apart if the board is at another place of the picture, larger, or otherwise tilted.
    """
    if not len(views):
        return np.empty(0, int)
    blur = np.where(np.isfinite(views.sharpness_px), views.sharpness_px, 0.0)
    sharp = np.flatnonzero(blur <= _MAX_BLUR * np.median(blur))
    if len(sharp) <= most:
        return sharp
    shape = _shapes(views)[sharp]
    chosen = [int(np.argmax(shape[:, 2:4].sum(1)))]  # the nearest board
    distance = np.linalg.norm(shape - shape[chosen[0]], axis=1)
    while len(chosen) < most:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(shape - shape[chosen[-1]], axis=1))
    return np.sort(sharp[chosen])


def _shapes(views: BoardViews) -> Float[np.ndarray, "views 5"]:
    """Place, extent and tilt of the corners in the picture, without units: means, deviations, correlation."""
    corners = views.corners_px / np.array(views.size_px)
    mean, deviation = np.nanmean(corners, axis=1), np.nanstd(corners, axis=1)
    centred = corners - mean[:, None]
    correlation = np.nanmean(centred[..., 0] * centred[..., 1], axis=1) / np.maximum(deviation.prod(-1), 1e-9)
    return np.column_stack([mean, 2 * deviation, 0.25 * correlation])


def covered_share(views: BoardViews) -> float:
    """Share of the cells of the picture, 8 x 6, in which a corner was seen."""
    return float((_counts(views) > 0).mean())


def coverage_svg(views: BoardViews) -> str:
    """Draw the corners that were seen; cells without any are red."""
    width, height = views.size_px
    scale = _WIDTH / width
    counts = _counts(views)
    across, down = _WIDTH / _CELLS[0], height * scale / _CELLS[1]
    cells = "".join(
        f'<rect x="{column * across:.1f}" y="{row * down:.1f}" width="{across:.1f}" height="{down:.1f}"/>'
        for row, column in np.argwhere(counts == 0)
    )
    corners = views.corners_px.reshape(-1, 2)
    corners = corners[np.isfinite(corners).all(-1)] * scale
    corners = corners[:: max(1, len(corners) // _MAX_DOTS)]
    dots = "".join(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="1.5"/>' for x, y in corners)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {height * scale:.0f}" role="img">'
        f"<title>Corners of the board in {len(views)} views</title>"
        f'<rect width="100%" height="100%" fill="#f4f4f4"/>'
        f'<g fill="#d62728" fill-opacity="0.25">{cells}</g><g fill="#1f4e79">{dots}</g></svg>\n'
    )


def _counts(views: BoardViews) -> np.ndarray:
    corners = views.corners_px.reshape(-1, 2)
    corners = corners[np.isfinite(corners).all(-1)]
    width, height = views.size_px
    counts, _, _ = np.histogram2d(
        corners[:, 1], corners[:, 0], bins=_CELLS[::-1], range=[[-0.5, height - 0.5], [-0.5, width - 0.5]]
    )
    return counts
