"""Figures of a picture: its darkness, its blur, and its brightness in coarse cells."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from pipeline.preflight.pictures.blur import blur_px

# Longest sides to which pictures are reduced: networks see no more than the first; in cells of the last a hand moves.
_SHARP_SIDE_PX, _VIEW_SIDE_PX, _CELLS_SIDE = 960, 240, 48
# Brightness, of 255, of a surface that reflects 18 % of the light when it gets a tenth of what it needs.
_DARK_LUMA = 40
# Detail of a view: what is smaller than this, in pixels of the view.
_DETAIL_PX = 4.0

DETAIL_MIN = 2.0
"""Least standard deviation of the detail of a view, in grey levels; a view with less shows nothing to recognise."""


@dataclass(frozen=True, slots=True, eq=False)
class PictureFigures:
    """Figures of one picture of a camera.

    Parameters
    ----------
    dark_share
        Share of the pixels that are darker than 40 of 255.
    blur_share
        Width of the sharpest edges as a share of the picture's longer side, see ``blur_px``; NaN without edges.
    blur_px
        The same in pixels of the picture, or of the picture reduced to 960 pixels.
    view
        Brightness, the longer side reduced to 240 pixels.
    cells
        Brightness, the longer side reduced to 48 cells.
    """

    dark_share: float
    blur_share: float
    blur_px: float
    view: Float[np.ndarray, "rows columns"]
    cells: Float[np.ndarray, "cell_rows cell_columns"]


def figures_of(image_rgb: UInt8[np.ndarray, "height width 3"]) -> PictureFigures:
    """Measure a picture."""
    luma = cv2.cvtColor(np.ascontiguousarray(image_rgb), cv2.COLOR_RGB2GRAY)
    sharp = reduced(luma, _SHARP_SIDE_PX)
    width_px = blur_px(sharp)
    return PictureFigures(
        dark_share=float(np.mean(sharp < _DARK_LUMA)),
        blur_share=width_px / max(sharp.shape),
        blur_px=width_px,
        view=reduced(luma, _VIEW_SIDE_PX).astype(np.float64),
        cells=reduced(luma, _CELLS_SIDE).astype(np.float64),
    )


def reduced(image: UInt8[np.ndarray, "..."], side_px: int) -> UInt8[np.ndarray, "..."]:
    """Reduce a picture until its longer side is at most ``side_px``; each pixel is the mean of those it covers."""
    height, width = image.shape[:2]
    scale = min(1.0, side_px / max(height, width))
    size_px = max(1, round(scale * width)), max(1, round(scale * height))
    return np.asarray(cv2.resize(image, size_px, interpolation=cv2.INTER_AREA))


def detail(view: Float[np.ndarray, "rows columns"]) -> Float[np.ndarray, "rows columns"]:
    """Fine structure of a view: what is left without its smooth part."""
    return view - cv2.GaussianBlur(view, (0, 0), _DETAIL_PX)


def correlation(first: Float[np.ndarray, "..."], second: Float[np.ndarray, "..."]) -> float:
    """Correlation coefficient of two pictures of the same size; 0 if one of them is uniform."""
    first, second = first - first.mean(), second - second.mean()
    norm = float(np.linalg.norm(first) * np.linalg.norm(second))
    return float(np.sum(first * second)) / norm if norm > 0.0 else 0.0


def largest_change(first: Float[np.ndarray, "..."], second: Float[np.ndarray, "..."]) -> float:
    """Largest difference of a cell between two pictures of the same size, in grey levels."""
    return float(np.abs(first - second).max())
