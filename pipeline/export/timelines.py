"""Frames of files: blocks of them, their numbers as text, and values before and after a person's own frames.

Blocks keep the memory small that writing a long capture needs.
"""

from collections.abc import Iterator
from itertools import islice
from typing import TextIO

import numpy as np
from jaxtyping import Bool, Float, Shaped

from pipeline.core.data.people import Track3D

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


def held(
    values: Shaped[np.ndarray, "rows *columns"], of_frames: range, frames: range
) -> Shaped[np.ndarray, "frames *columns"]:
    """Values at some frames from values of ``of_frames``, of which the nearest one holds before and after them.

    Frames of ``of_frames`` alone are a view.
    """
    if of_frames.start <= frames.start and frames.stop <= of_frames.stop:
        return values[frames.start - of_frames.start : frames.stop - of_frames.start]
    return values[np.clip(np.arange(frames.start, frames.stop) - of_frames.start, 0, len(of_frames) - 1)]


def unknown_outside(
    values: Float[np.ndarray, "rows *columns"], of_frames: range, frames: range
) -> Float[np.ndarray, "frames *columns"]:
    """Values at some frames from values of ``of_frames``, NaN before and after them."""
    found = np.full((len(frames), *values.shape[1:]), np.nan)
    inside = range(max(frames.start, of_frames.start), min(frames.stop, of_frames.stop))
    if inside:
        rows = slice(inside.start - of_frames.start, inside.stop - of_frames.start)
        found[inside.start - frames.start : inside.stop - frames.start] = values[rows]
    return found


def presence(track: Track3D, frames: range) -> Bool[np.ndarray, " frames"]:
    """Frames in which the person is there: any joint has a position."""
    is_there = np.zeros(len(frames), bool)
    known = np.isfinite(track.xyz_m).all(-1).any(-1)
    is_there[np.flatnonzero(known) + track.start_frame - frames.start] = True
    return is_there
