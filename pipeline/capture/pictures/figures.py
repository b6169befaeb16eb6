"""Figures of a picture: its darkness, its blur, and its brightness in coarse cells."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

# Longest sides to which pictures are reduced: networks see no more than the first; in cells of the last a hand moves.
_SHARP_SIDE_PX, _VIEW_SIDE_PX, _CELLS_SIDE = 960, 240, 48
# Brightness, of 255, of a surface that reflects 18 % of the light when it gets a tenth of what it needs.
_DARK_LUMA = 40
# Detail of a view: what is smaller than this, in pixels of the view.
_DETAIL_PX = 4.0

DETAIL_MIN = 2.0
"""Least standard deviation of the detail of a view, in grey levels; a view with less shows nothing to recognise."""
# Scales in pixels at which gradients are compared.
_FINE_PX, _COARSE_PX = 1.0, 4.0
# A place where the gradient is strongest, and a neighbourhood in which its fine edge is.
_PEAK_PX, _NEAR_PX = 5, 7
# Steps of fewer grey levels are noise, or the grain of a codec. Fewer edges say nothing.
_MIN_STEP, _MIN_EDGES = 16.0, 20
# Of all edges the sharpest count: what is behind the people, or before them, may be out of focus.
_SHARPEST = 0.25
_MAX_BLUR_PX = 16.0


@dataclass(frozen=True, slots=True, eq=False)
class PictureFigures:
    """Figures of one picture of a camera."""

    dark_share: float  # Share of the pixels that are darker than 40 of 255
    # Width of the sharpest edges as a share of the picture's longer side, see ``blur_px``; NaN without edges
    blur_share: float
    blur_px: float  # The same in pixels of the picture, or of the picture reduced to 960 pixels
    view: Float[np.ndarray, "rows columns"]  # Brightness, the longer side reduced to 240 pixels
    cells: Float[np.ndarray, "cell_rows cell_columns"]  # Brightness, the longer side reduced to 48 cells


def measure_figures(image_rgb: UInt8[np.ndarray, "height width 3"]) -> PictureFigures:
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


def blur_px(luma: UInt8[np.ndarray, "height width"]) -> float:
    """Width of the sharpest edges: standard deviation of the Gaussian that blurs them.

    A step of height A that a Gaussian of width b blurs has the gradient A / sqrt(2 pi (b^2 + s^2)) at scale s. The
    ratio of its gradients at two scales gives b (Zhuo and Sim 2011, Defocus map estimation from a single image, eq. 4
    to 6), whatever the contrast. ``luma`` is the brightness. Returns pixels, at most 16; NaN if the picture has too few
    edges.
    """
    fine, coarse = (_gradient(luma, scale_px) for scale_px in (_FINE_PX, _COARSE_PX))
    is_peak = coarse == cv2.dilate(coarse, np.ones((_PEAK_PX, _PEAK_PX), np.uint8))
    is_edge = is_peak & (coarse * np.sqrt(2.0 * np.pi) * _COARSE_PX >= _MIN_STEP)
    if np.count_nonzero(is_edge) < _MIN_EDGES:
        return np.nan
    near = cv2.dilate(fine, np.ones((_NEAR_PX, _NEAR_PX), np.uint8))
    ratio2 = (near[is_edge] / coarse[is_edge]) ** 2
    with np.errstate(divide="ignore"):
        width2_px = (_COARSE_PX**2 - ratio2 * _FINE_PX**2) / (ratio2 - 1.0)
    # An edge that a scale of 4 pixels does not blur is blurred more than can be measured.
    widths_px = np.where(ratio2 > 1.0, np.sqrt(np.clip(width2_px, 0.0, _MAX_BLUR_PX**2)), _MAX_BLUR_PX)
    return float(np.quantile(widths_px, _SHARPEST))


def _gradient(luma: UInt8[np.ndarray, "height width"], scale_px: float) -> Float[np.ndarray, "height width"]:
    """Magnitude of the gradient of the picture at a scale, in grey levels a pixel."""
    smooth = cv2.GaussianBlur(luma.astype(np.float32), (0, 0), scale_px)
    along_y, along_x = np.gradient(smooth)
    return np.hypot(along_x, along_y)
