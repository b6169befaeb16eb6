"""Frames in blocks, and numbers as text: what keeps the writers of long captures small and fast."""

from collections.abc import Iterator
from itertools import islice
from typing import TextIO

import numpy as np
from jaxtyping import Float

BLOCK_FRAMES = 512
"""So many frames are in memory as text at a time."""


def frame_blocks(num_frames: int) -> Iterator[slice]:
    """Ranges of at most ``BLOCK_FRAMES`` frames."""
    for start in range(0, num_frames, BLOCK_FRAMES):
        yield slice(start, min(start + BLOCK_FRAMES, num_frames))


def fixed(values: Float[np.ndarray, "rows columns"], decimals: int, separator: str = " ") -> list[str]:
    """Rows as text with so many decimals. Adding zero turns -0.0 into 0.0; NaN is ``nan``."""
    template = separator.join([f"%.{decimals}f"] * values.shape[1])
    return [template % tuple(row) for row in (np.round(values, decimals) + 0.0).tolist()]


def read_rows(file: TextIO, separator: str) -> Iterator[Float[np.ndarray, "rows columns"]]:
    """Numbers of a text file's rows from here on, some of them at a time; an empty cell is NaN."""
    while lines := list(islice(file, BLOCK_FRAMES)):
        yield np.array([[cell or "nan" for cell in line.strip("\r\n").split(separator)] for line in lines], dtype=float)
