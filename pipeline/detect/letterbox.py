"""Letterbox of an image in a network's input: same aspect ratio, padding at the right and the bottom."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8


@dataclass(frozen=True, slots=True)
class LetterBox:
    """Mapping between pixels of an image and pixels of a network's input.

    Pixel (0, 0) is the centre of the first pixel in both. Sizes are whole numbers, so the scales of the two axes differ
    slightly.
    """

    # Width and height of the image, of the image inside the network's input, and of the network's input
    image_size_px: tuple[int, int]
    scaled_size_px: tuple[int, int]
    padded_size_px: tuple[int, int]

    @property
    def scale(self) -> Float[np.ndarray, " 2"]:
        """Pixels of the network's input for each image pixel, in x and y."""
        return np.array(self.scaled_size_px) / np.array(self.image_size_px)

    def network_from_image(self, points_px: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
        """Map image pixels to pixels of the network's input; NaN stays NaN."""
        return (points_px + 0.5) * self.scale - 0.5

    def image_from_network(self, points_px: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
        """Map pixels of the network's input to image pixels; NaN stays NaN."""
        return (points_px + 0.5) / self.scale - 0.5


def fit_letterbox(image_size_px: tuple[int, int], scale: float, multiple: int) -> LetterBox:
    """Make the letterbox of an image that is scaled and padded.

    ``scale`` is in pixels of the network's input for each image pixel; padded width and height are multiples of
    ``multiple``.
    """
    width, height = (max(1, round(side * scale)) for side in image_size_px)
    return LetterBox(image_size_px, (width, height), (_ceil(width, multiple), _ceil(height, multiple)))


def _ceil(value: int, multiple: int) -> int:
    return -(-value // multiple) * multiple


def apply_letterbox(
    image: UInt8[np.ndarray, "height width 3"], letterbox: LetterBox
) -> UInt8[np.ndarray, "padded_height padded_width 3"]:
    """Resample an image (bilinear) into a network's input; the padding is black."""
    width, height = letterbox.scaled_size_px
    padded_width, padded_height = letterbox.padded_size_px
    padded = np.zeros((padded_height, padded_width, 3), np.uint8)
    padded[:height, :width] = cv2.resize(image, (width, height), interpolation=cv2.INTER_LINEAR)
    return padded
