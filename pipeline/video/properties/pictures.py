"""Properties of a video's pictures that people should know of: pixels that are not square, interlacing."""

from fractions import Fraction

from pipeline.errors import Problem

# Encoders that round sizes write ratios such as 404:405. Real ones, from 8:9 on, differ from 1 by a tenth.
_MAX_ROUNDING = 0.01
# Widest and narrowest pixels of real formats are 2:1 (anamorphic film) and 8:9; others are errors of a file.
_MAX_ASPECT = 4


def square_pixels(width_px: int, pixel_aspect: Fraction | None) -> tuple[int, list[Problem]]:
    """Width of a picture whose pixels are made square, and a warning if they are not.

    Parameters
    ----------
    pixel_aspect
        Width of a stored pixel over its height, as the file states it (sample aspect ratio); ``None`` or 0: unknown,
        which counts as square.
    """
    if not pixel_aspect or abs(pixel_aspect - 1) <= _MAX_ROUNDING:
        return width_px, []
    shape = f"{pixel_aspect.numerator}:{pixel_aspect.denominator}"
    if not Fraction(1, _MAX_ASPECT) <= pixel_aspect <= _MAX_ASPECT:
        message = f"The file states pixels of {shape}, which is not plausible. They are taken as square."
        return width_px, [Problem("pixel_aspect", message, hint="Export the video with square pixels.")]
    square_px = max(1, round(width_px * pixel_aspect))
    message = f"The pixels are not square ({shape}): the pictures are scaled from {width_px} to {square_px} columns."
    return square_px, [
        Problem("pixel_aspect", message, hint="The calibration may be of the stored or of the scaled pictures.")
    ]


def interlaced() -> Problem:
    """Build the warning of a video whose pictures are made of two fields."""
    return Problem(
        "interlaced_video",
        "The video is interlaced: each picture shows two instants, and moving people have combed edges.",
        hint="Record progressively, or deinterlace the video before.",
    )
