"""Picture that is turned in its plane before a network sees it."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from pipeline.core.data.turns import is_quarter_turn, turned_axes


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
