"""Colours of people, equal in pictures and in models."""

import colorsys

Rgb = tuple[int, int, int]

# The golden ratio spreads hues evenly however many people there are.
_HUE_STEP = 0.618034


def color_rgb(track_id: int) -> Rgb:
    """Bright colour of a person, different from the colours of the next numbers."""
    red, green, blue = colorsys.hsv_to_rgb(track_id * _HUE_STEP % 1.0, 0.85, 1.0)
    return round(255 * red), round(255 * green), round(255 * blue)
