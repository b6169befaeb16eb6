"""Square regions of an image, possibly turned, and their crops at the size of a network's input.

The edges of a region are the edges of its crop. Pixel (0, 0) is the centre of the first pixel in both, so the edges of
a crop of n pixels are at -0.5 and n - 0.5.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8

# Blocks of averaged pixels around a region that its interpolation may need.
_MARGIN = 2


@dataclass(frozen=True, slots=True)
class Region:
    """Square region of an image."""

    center_px: tuple[float, float]  # Centre in pixels of the image
    side_px: float  # Length of a side in pixels of the image; positive
    # Angle from the upward axis of the image to the upward axis of the crop, clockwise in the image
    angle_rad: float = 0.0

    def crop_from_image(self, points_px: Float[np.ndarray, "*batch 2"], crop_px: int) -> Float[np.ndarray, "*batch 2"]:
        """Map pixels of the image to pixels of a crop with sides of ``crop_px`` pixels; NaN stays NaN."""
        turned_px = (points_px - self.center_px) @ self._axes
        return turned_px * (crop_px / self.side_px) + (crop_px - 1) / 2

    def image_from_crop(self, points_px: Float[np.ndarray, "*batch 2"], crop_px: int) -> Float[np.ndarray, "*batch 2"]:
        """Map pixels of a crop with sides of ``crop_px`` pixels to pixels of the image; NaN stays NaN."""
        turned_px = (points_px - (crop_px - 1) / 2) * (self.side_px / crop_px)
        return turned_px @ self._axes.T + self.center_px

    @property
    def _axes(self) -> Float[np.ndarray, "2 2"]:
        """Directions of the crop's x and y axes in the image, as columns."""
        cos, sin = np.cos(self.angle_rad), np.sin(self.angle_rad)
        return np.array([[cos, -sin], [sin, cos]])


def upward(vector_px: Float[np.ndarray, " 2"]) -> float:
    """Angle of a region in radians whose upward axis has the direction of a vector in the image."""
    return float(np.arctan2(vector_px[0], -vector_px[1]))


def crop(
    image_rgb: UInt8[np.ndarray, "height width 3"], region: Region, crop_px: int
) -> Float32[np.ndarray, "1 3 crop_px crop_px"]:
    """Resample a region of an image (bilinear) into a network's input.

    Pixels of large regions are averaged first. The border of the image is repeated outside of the image. Values are
    from 0 to 1.
    """
    if (num_halvings := int(np.log2(region.side_px / crop_px))) > 0:
        image_rgb, region = _shrink(image_rgb, region, num_halvings)
    corners_px = region.crop_from_image(np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]), crop_px)
    origin_px = corners_px[0]
    matrix = np.column_stack([corners_px[1] - origin_px, corners_px[2] - origin_px, origin_px])
    resampled = cv2.warpAffine(
        image_rgb, matrix, (crop_px, crop_px), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.ascontiguousarray(resampled.transpose(2, 0, 1)[None], np.float32) / np.float32(255)


def _shrink(
    image_rgb: UInt8[np.ndarray, "height width 3"], region: Region, num_halvings: int
) -> tuple[UInt8[np.ndarray, "_ _ 3"], Region]:
    """Halve the image around a region some times, by averaging; return the region in it."""
    height, width = image_rgb.shape[:2]
    factor = 2**num_halvings
    turn = abs(np.cos(region.angle_rad)) + abs(np.sin(region.angle_rad))
    reach_px = turn * region.side_px / 2 + _MARGIN * factor
    x0, y0 = (max(0, int(center - reach_px)) for center in region.center_px)
    columns, rows = (
        max(0, min(size, int(center + reach_px) + 1) - first) // factor
        for center, first, size in zip(region.center_px, (x0, y0), (width, height), strict=True)
    )
    if columns == 0 or rows == 0:
        return image_rgb, region
    small = image_rgb[y0 : y0 + rows * factor, x0 : x0 + columns * factor]
    for _ in range(num_halvings):  # OpenCV averages blocks of two quickly, larger ones slowly
        small = cv2.resize(small, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    center_x, center_y = (
        (center - first + 0.5) / factor - 0.5 for center, first in zip(region.center_px, (x0, y0), strict=True)
    )
    return small, Region((center_x, center_y), region.side_px / factor, region.angle_rad)
