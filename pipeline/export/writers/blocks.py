"""Blocks of frames, and numbers as text, so that writing a long capture needs little memory."""

from collections.abc import Iterator
from itertools import islice
from typing import TextIO

import numpy as np
from jaxtyping import Float

BLOCK_FRAMES = 512
"""Number of frames that are converted to text at once."""


def frame_blocks(num_frames: int) -> Iterator[slice]:
    """Ranges of at most ``BLOCK_FRAMES`` frames."""
    for start in range(0, num_frames, BLOCK_FRAMES):
        yield slice(start, min(start + BLOCK_FRAMES, num_frames))


def held_blocks(of_frames: range, frames: range) -> Iterator[tuple[range, int]]:
    """Blocks of ``of_frames`` that make up ``frames``, each with the number of times that it stands there.

    A frame that holds before or after ``of_frames`` is a block by itself, so that it is worked on once.
    """
    num_before = min(max(of_frames.start - frames.start, 0), len(frames))
    inside = of_frames[max(frames.start - of_frames.start, 0) : max(frames.stop - of_frames.start, 0)]
    for block in frame_blocks(num_before):
        yield of_frames[:1], block.stop - block.start
    for block in frame_blocks(len(inside)):
        yield inside[block], 1
    for block in frame_blocks(len(frames) - num_before - len(inside)):
        yield of_frames[-1:], block.stop - block.start


def fixed(values: Float[np.ndarray, "rows columns"], decimals: int, separator: str = " ") -> list[str]:
    """Format rows as text with a fixed number of decimals; -0.0 becomes 0.0, NaN becomes ``nan``."""
    return filled(separator.join([f"%.{decimals}f"] * values.shape[1]), values, decimals)


def filled(template: str, values: Float[np.ndarray, "rows columns"], decimals: int) -> list[str]:
    """Format rows as text by a template for one of them, whose numbers have some decimals; -0.0 becomes 0.0."""
    # Adding zero turns -0.0 into 0.0.
    return [template % tuple(row) for row in (np.round(values, decimals) + 0.0).tolist()]


def read_rows(file: TextIO, separator: str) -> Iterator[Float[np.ndarray, "rows columns"]]:
    """Read the remaining rows of a text file as numbers, block by block; an empty cell is NaN."""
    while lines := list(islice(file, BLOCK_FRAMES)):
        # A pose that holds is a line over and over.
        parsed = lines[:1] if lines.count(lines[0]) == len(lines) else lines
        if any(_has_empty_cell(line.strip("\r\n"), separator) for line in parsed):
            cells = [[cell or "nan" for cell in line.strip("\r\n").split(separator)] for line in parsed]
            values = np.array(cells, float)
        else:
            values = np.loadtxt(parsed, delimiter=separator, comments=None, ndmin=2)
        yield np.repeat(values, len(lines) // len(parsed), axis=0)


def _has_empty_cell(line: str, separator: str) -> bool:
    return line.startswith(separator) or line.endswith(separator) or 2 * separator in line
