"""Letterbox of an image in a network's input: upright, same aspect ratio, padding at the right and the bottom."""

import math
import threading
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from pipeline.core.data.turns import is_quarter_turn, turned_axes
from pipeline.video.rotation import Rotator


@dataclass(frozen=True, slots=True)
class PictureTurn:
    """Mapping between pixels of a picture and pixels of the turned picture around it.

    Pixel (0, 0) is the centre of the first pixel in both; the centres of both pictures meet.
    """

    image_size_px: tuple[int, int]  # Width and height of the picture
    turn_deg: float  # Counterclockwise turn

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the turned picture, which contains all of the picture."""
        reach = np.abs(turned_axes(self.turn_deg)).T @ np.array(self.image_size_px)
        # A pixel more than an exact whole number is rounding.
        width, height = (max(1, math.ceil(side - 1e-6)) for side in reach)
        return width, height

    @property
    def turned_from_image(self) -> Float[np.ndarray, "2 3"]:
        """Affine map from pixels of the picture to pixels of the turned picture."""
        axes = turned_axes(self.turn_deg)
        return np.column_stack([axes.T, _middle(self.size_px) - _middle(self.image_size_px) @ axes])

    def to_turned(self, points_px: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
        """Map pixels of the picture to pixels of the turned picture; NaN stays NaN."""
        if self.turn_deg == 0.0:
            return points_px
        return (points_px - _middle(self.image_size_px)) @ turned_axes(self.turn_deg) + _middle(self.size_px)

    def to_image(self, points_px: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
        """Map pixels of the turned picture to pixels of the picture; NaN stays NaN."""
        if self.turn_deg == 0.0:
            return points_px
        return (points_px - _middle(self.size_px)) @ turned_axes(self.turn_deg).T + _middle(self.image_size_px)

    @property
    def is_quarter(self) -> bool:
        """True if rows and columns of the picture become rows or columns of the turned one."""
        return is_quarter_turn(self.turn_deg)


def _middle(size_px: tuple[int, int]) -> Float[np.ndarray, " 2"]:
    return (np.array(size_px) - 1) / 2


_OF_THREAD = threading.local()


@dataclass(frozen=True, slots=True)
class LetterBox:
    """Mapping between pixels of an image and pixels of a network's input.

    Pixel (0, 0) is the centre of the first pixel in both. Sizes are whole numbers, so the scales of the two axes differ
    slightly.
    """

    # Width and height of the image, of the turned image inside the network's input, and of the network's input
    image_size_px: tuple[int, int]
    scaled_size_px: tuple[int, int]
    padded_size_px: tuple[int, int]
    turn_deg: float = 0.0  # Counterclockwise turn of the image before it is scaled

    @property
    def scale(self) -> Float[np.ndarray, " 2"]:
        """Pixels of the network's input for each pixel of the turned image, in x and y."""
        return np.array(self.scaled_size_px) / np.array(self.turn.size_px)

    @property
    def turn(self) -> PictureTurn:
        """Turn of the image."""
        return PictureTurn(self.image_size_px, self.turn_deg)

    def network_from_image(self, points_px: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
        """Map image pixels to pixels of the network's input; NaN stays NaN."""
        return (self.turn.to_turned(points_px) + 0.5) * self.scale - 0.5

    def image_from_network(self, points_px: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
        """Map pixels of the network's input to image pixels; NaN stays NaN."""
        return self.turn.to_image((points_px + 0.5) / self.scale - 0.5)


def fit_letterbox(image_size_px: tuple[int, int], scale: float, multiple: int, turn_deg: float = 0.0) -> LetterBox:
    """Make the letterbox of an image that is turned, scaled and padded.

    ``scale`` is in pixels of the network's input for each image pixel; padded width and height are multiples of
    ``multiple``. ``turn_deg`` is the counterclockwise turn that brings the image upright.
    """
    turned_size_px = PictureTurn(image_size_px, turn_deg).size_px
    width, height = (max(1, round(side * scale)) for side in turned_size_px)
    return LetterBox(image_size_px, (width, height), (_ceil(width, multiple), _ceil(height, multiple)), turn_deg)


def _ceil(value: int, multiple: int) -> int:
    return -(-value // multiple) * multiple


def apply_letterbox(
    image: UInt8[np.ndarray, "height width 3"], letterbox: LetterBox, padding: int = 0
) -> UInt8[np.ndarray, "padded_height padded_width 3"]:
    """Resample an image (bilinear) into a network's input; ``padding`` is the grey around it."""
    width, height = letterbox.scaled_size_px
    padded_width, padded_height = letterbox.padded_size_px
    if letterbox.turn.is_quarter:
        padded = np.full((padded_height, padded_width, 3), padding, np.uint8)
        # Turned first: the network sees, to the last bit, what it sees of an upright camera. Turned afterwards, a pixel
        # in 300 would differ by a grey level, which moves joints by a third of a pixel of the network's input.
        upright = _rotator()(image, round(letterbox.turn_deg / 90.0))
        padded[:height, :width] = cv2.resize(upright, (width, height), interpolation=cv2.INTER_LINEAR)
        return padded
    corners_px = letterbox.network_from_image(np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]))
    matrix = np.column_stack([corners_px[1] - corners_px[0], corners_px[2] - corners_px[0], corners_px[0]])
    return cv2.warpAffine(
        image, matrix, (padded_width, padded_height), flags=cv2.INTER_LINEAR, borderValue=(padding,) * 3
    )


def _rotator() -> Rotator:
    """Rotator of this thread, whose memory serves all pictures: new pages take longer than the rotation."""
    if not hasattr(_OF_THREAD, "rotator"):
        _OF_THREAD.rotator = Rotator()
    rotator: Rotator = _OF_THREAD.rotator
    return rotator
