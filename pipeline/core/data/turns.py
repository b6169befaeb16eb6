"""Turns of pictures in their plane: counterclockwise, in degrees, from the picture as a video shows it."""

import numpy as np
from jaxtyping import Float


def turned_axes(turn_deg: float) -> Float[np.ndarray, "2 2"]:
    """Directions in a picture of the x and y axes of the picture turned counterclockwise, as columns.

    They are exact for quarter turns. A vector ``v`` of the picture is ``v @ turned_axes(turn_deg)`` in the turned one.
    """
    quarters, rest_deg = divmod(turn_deg % 360.0, 90.0)
    cos, sin = np.cos(np.radians(rest_deg)), np.sin(np.radians(rest_deg))
    for _ in range(int(quarters)):
        cos, sin = -sin, cos
    return np.array([[cos, -sin], [sin, cos]]) + 0.0  # without negative zeros


def is_quarter_turn(turn_deg: float) -> bool:
    """Test for a turn by a multiple of 90 degrees."""
    return turn_deg % 90.0 == 0.0


def upright_size_px(size_px: tuple[int, int], turn_deg: float) -> tuple[int, int]:
    """Width and height of a picture after the nearest quarter turn."""
    return size_px[::-1] if round(turn_deg / 90.0) % 2 else size_px
