"""Numbers of the corners of a grid, by the bits of all markers between them.

A marker whose bits are blurred can't be read alone. All markers of a board together can be: their shades correlate with
the bits at one place of the board only.
"""

from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from pipeline.calibration.board.corner_search.squares import SquareGrid
from pipeline.calibration.board.spec import Board
from pipeline.core.data.arrays import read_only

# Shades and bits must correlate at least so much, with at least so many standard deviations of Fisher's z; the second
# best place may have this share of them.
_MIN_CORRELATION, _MIN_SIGMAS, _MAX_SECOND = 0.5, 6.0, 0.7
_MIN_MARKERS = 3
# Least number of corners of the grid that are corners of the board; others may be of its outline.
_MIN_CORNERS = 6
# A shade is the mean of this many samples along each side of a bit.
_SAMPLES = 3


class _Fit(NamedTuple):
    """Place of a grid on the board: after quarter turns, its first square is in this row and column."""

    sigmas: float
    correlation: float
    turns: int
    top: int
    left: int


def number_corners(
    gray: UInt8[np.ndarray, "height width"], grid: SquareGrid, board: Board
) -> Float[np.ndarray, "corners 2"] | None:
    """Number the corners of a grid on a ChArUco board.

    Pixels are by number of the corner, NaN where none was found; ``None`` if the markers do not tell the numbers.
    """
    has_corner = grid.is_found
    is_cell = has_corner[:-1, :-1] & has_corner[1:, :-1] & has_corner[:-1, 1:] & has_corner[1:, 1:]
    shades = _shades(gray, grid, board)
    fits = sorted(fit for turns in range(4) for fit in _fits(shades, is_cell, has_corner, turns, board))
    if not fits or fits[-1].correlation < _MIN_CORRELATION or fits[-1].sigmas < _MIN_SIGMAS:
        return None
    if len(fits) > 1 and fits[-2].sigmas > _MAX_SECOND * fits[-1].sigmas:
        return None
    return _numbered(grid, fits[-1], board)


def _fits(
    shades: Float[np.ndarray, "rows columns bits bits"],
    is_cell: Bool[np.ndarray, "rows columns"],
    is_found: Bool[np.ndarray, "corner_rows corner_columns"],
    turns: int,
    board: Board,
) -> list[_Fit]:
    """Fits of the grid, turned by quarters, at all places on the board."""
    bits, has_marker = _bits(board)
    shades = np.rot90(np.rot90(shades, turns, axes=(0, 1)), turns, axes=(2, 3))
    is_cell, is_found = np.rot90(is_cell, turns), np.rot90(is_found, turns)
    fits = []
    for top in range(1 - is_cell.shape[0], board.rows):
        for left in range(1 - is_cell.shape[1], board.cols):
            here, there = _overlap(is_cell.shape, (board.rows, board.cols), (top, left))
            chosen = is_cell[here] & has_marker[there]
            corners, _ = _overlap(is_found.shape, (board.rows - 1, board.cols - 1), (top - 1, left - 1))
            if chosen.sum() < _MIN_MARKERS or is_found[corners].sum() < _MIN_CORNERS:
                continue
            seen, expected = shades[here][chosen].ravel(), bits[there][chosen].ravel()
            if np.ptp(seen) > 0 and np.ptp(expected) > 0:
                correlation = min(float(np.corrcoef(seen, expected)[0, 1]), 0.999)
                fits.append(_Fit(np.arctanh(correlation) * np.sqrt(seen.size - 3), correlation, turns, top, left))
    return fits


def _overlap(
    shape: tuple[int, ...], board_shape: tuple[int, int], at: tuple[int, int]
) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Rows and columns of an array that lie on the board if its first element is at a row and column of the board."""
    first = [max(0, -begin) for begin in at]
    last = [max(0, min(own, of_board - begin)) for own, of_board, begin in zip(shape, board_shape, at, strict=True)]
    here = tuple(slice(a, b) for a, b in zip(first, last, strict=True))
    there = tuple(slice(a + begin, b + begin) for a, b, begin in zip(first, last, at, strict=True))
    return here, there


def _numbered(grid: SquareGrid, fit: _Fit, board: Board) -> Float[np.ndarray, "corners 2"]:
    numbered = np.full((board.rows - 1, board.cols - 1, 2), np.nan)
    turned = np.rot90(grid.corners_px, fit.turns)
    here, there = _overlap(turned.shape[:2], numbered.shape[:2], (fit.top - 1, fit.left - 1))
    numbered[there] = turned[here]
    return numbered.reshape(-1, 2)


def _shades(
    gray: UInt8[np.ndarray, "height width"], grid: SquareGrid, board: Board
) -> Float[np.ndarray, "rows columns bits bits"]:
    num_bits = _bits(board)[0].shape[-1]
    samples = (np.arange(num_bits * _SAMPLES) + 0.5) / _SAMPLES + 1
    places = 0.5 + board.marker_m / board.square_m * (samples / (num_bits + 2) - 0.5)
    rows, columns = (length - 1 for length in grid.corners_px.shape[:2])
    y = (np.arange(rows)[:, None] + places).ravel()
    x = (np.arange(columns)[:, None] + places).ravel()
    points = np.stack(np.meshgrid(x, y), axis=-1)
    points_px = cv2.perspectiveTransform(points.reshape(1, -1, 2), grid.picture_from_grid).reshape(points.shape)
    map_x, map_y = np.moveaxis(points_px.astype(np.float32), -1, 0)
    sampled = cv2.remap(gray, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(float)
    split = sampled.reshape(rows, num_bits, _SAMPLES, columns, num_bits, _SAMPLES)
    return np.asarray(split.mean((2, 5)).transpose(0, 2, 1, 3))


@lru_cache(maxsize=8)
def _bits(board: Board) -> tuple[Float[np.ndarray, "rows columns bits bits"], Bool[np.ndarray, "rows columns"]]:
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    size = dictionary.markerSize
    bits = np.zeros((board.rows, board.cols, size, size))
    has_marker = np.zeros((board.rows, board.cols), bool)
    numbers, places_m = np.asarray(board.charuco.getIds()).ravel(), np.asarray(board.charuco.getObjPoints())
    for number, points_m in zip(numbers, places_m, strict=True):
        column, row = np.floor(points_m.mean(0)[:2] / board.square_m).astype(int)
        bits[row, column] = cv2.aruco.Dictionary.getBitsFromByteList(dictionary.bytesList[number : number + 1], size)
        has_marker[row, column] = True
    return read_only(1 - bits if board.is_inverted else bits), read_only(has_marker)
