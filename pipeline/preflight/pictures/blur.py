"""Blur of a picture, by the widths of its edges."""

import cv2
import numpy as np
from jaxtyping import Float, UInt8

# Scales in pixels at which gradients are compared.
_FINE_PX, _COARSE_PX = 1.0, 4.0
# A place where the gradient is strongest, and a neighbourhood in which its fine edge is.
_PEAK_PX, _NEAR_PX = 5, 7
# Steps of fewer grey levels are noise, or the grain of a codec. Fewer edges say nothing.
_MIN_STEP, _MIN_EDGES = 16.0, 20
# Of all edges the sharpest count: what is behind the people, or before them, may be out of focus.
_SHARPEST = 0.25
_MAX_BLUR_PX = 16.0


def blur_px(luma: UInt8[np.ndarray, "height width"]) -> float:
    """Width of the sharpest edges: standard deviation of the Gaussian that blurs them.

    A step of height A that a Gaussian of width b blurs has the gradient A / sqrt(2 pi (b^2 + s^2)) at scale s. The
    ratio of its gradients at two scales gives b (Zhuo and Sim 2011, Defocus map estimation from a single image, eq. 4
    to 6), whatever the contrast.

    Parameters
    ----------
    luma
        Brightness.

    Returns
    -------
        Pixels, at most 16; NaN if the picture has too few edges.
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
