"""Boards: chessboards and ChArUco boards, parsed from a specification, and drawn."""

import re
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from pipeline.core.data.arrays import read_only
from pipeline.core.errors import InputError, Problem
from pipeline.core.options.job_choices import BOARD_FORM
from pipeline.core.problems.session_codes import BOARD_INVALID

_SPEC = re.compile(
    r"(?P<kind>chessboard|charuco):(?P<cols>\d{1,3})x(?P<rows>\d{1,3}):(?P<square>[0-9.eE-]+)"
    r"(:(?P<marker>[0-9.eE-]+):(?P<dictionary>[A-Za-z0-9_]+))?"
)
_SIDE_RANGE = range(2, 100)
_SQUARE_RANGE_M = (0.002, 2.0)


@dataclass(frozen=True, slots=True)
class Board:
    """A flat board. Its corners are numbered along the rows; x along a row, y down the columns, z into the board."""

    # ``chessboard``: numbers of inner corners, as OpenCV counts them; ``charuco``: numbers of squares
    kind: Literal["chessboard", "charuco"]
    # Numbers along the width and the height
    cols: int
    rows: int
    # Sides of a square and of a marker
    square_m: float
    marker_m: float = 0.0
    dictionary: str = ""  # Name of the dictionary of the markers, such as ``DICT_4X4_50``
    # How the board is printed, which no specification states: white on black, and with the markers in the squares that
    # OpenCV before 4.6 gave them if the number of rows is even
    is_inverted: bool = False
    is_legacy: bool = False

    @property
    def corner_counts(self) -> tuple[int, int]:
        """Numbers of inner corners along the width and the height."""
        return (self.cols, self.rows) if self.kind == "chessboard" else (self.cols - 1, self.rows - 1)

    @property
    def num_corners(self) -> int:
        """Number of inner corners."""
        return self.corner_counts[0] * self.corner_counts[1]

    @property
    def corners_m(self) -> Float[np.ndarray, "corners 3"]:
        """Inner corners in the board's frame, by number."""
        across, down = self.corner_counts
        grid = np.stack(np.meshgrid(np.arange(across), np.arange(down)), axis=-1).reshape(-1, 2)
        first = 0 if self.kind == "chessboard" else 1
        return read_only(np.column_stack([(grid + first) * self.square_m, np.zeros(len(grid))]))

    @property
    def is_ambiguous(self) -> bool:
        """True if the board looks the same after half a turn: a chessboard with both counts odd or both even."""
        return self.kind == "chessboard" and (self.cols - self.rows) % 2 == 0

    @property
    def prints(self) -> tuple["Board", ...]:
        """Boards that the specification may mean, the usual one first.

        The negative of a chessboard is the board itself, turned, unless its numbers are both even or both odd and not
        equal.
        """
        if self.kind == "chessboard":
            is_turned = not self.is_ambiguous or self.cols == self.rows
            return (self,) if is_turned else (self, replace(self, is_inverted=True))
        legacy = (False, True) if self.rows % 2 == 0 else (False,)
        return tuple(
            replace(self, is_legacy=is_legacy, is_inverted=is_inverted)
            for is_legacy, is_inverted in product(legacy, (False, True))
        )

    @property
    def exchanged(self) -> "Board":
        """Board with its numbers along width and height exchanged: printed or declared the other way round."""
        return replace(self, cols=self.rows, rows=self.cols)

    @property
    def charuco(self) -> cv2.aruco.CharucoBoard:
        """Board as OpenCV detects it."""
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        board = cv2.aruco.CharucoBoard((self.cols, self.rows), self.square_m, self.marker_m, dictionary)
        board.setLegacyPattern(self.is_legacy)
        return board

    @property
    def margin_shade(self) -> int:
        """Shade around the pattern, of 255."""
        return 0 if self.is_inverted else 255

    def __str__(self) -> str:
        marker = f":{self.marker_m:g}:{self.dictionary}" if self.kind == "charuco" else ""
        return f"{self.kind}:{self.cols}x{self.rows}:{self.square_m:g}{marker}"


def parse_board(text: str) -> Board:
    """Parse the specification of a board.

    Raises ``InputError`` with all problems of the specification.

    >>> parse_board("chessboard:9x6:0.06").num_corners
    54
    """
    match = _SPEC.fullmatch(text)
    if match is None:
        raise InputError([_problem(f"{text!r} is not a board.", f"Write {BOARD_FORM}.")])
    kind: Literal["chessboard", "charuco"] = "charuco" if match["kind"] == "charuco" else "chessboard"
    problems = []
    if (kind == "charuco") != (match["marker"] is not None):
        fault = "needs the side of a marker and a dictionary" if kind == "charuco" else "has no markers"
        raise InputError([_problem(f"A {kind} board {fault}.", f"Write {BOARD_FORM}.")])
    cols, rows = int(match["cols"]), int(match["rows"])
    if min(cols, rows) not in _SIDE_RANGE or (kind == "charuco" and min(cols, rows) < _SIDE_RANGE.start + 1):
        counted = "squares, at least 3" if kind == "charuco" else "inner corners, at least 2"
        problems.append(_problem(f"The board has {cols} x {rows}; these are {counted} a side, fewer than 100."))
    square_m, marker_m = _length_m(match["square"]), _length_m(match["marker"] or "0")
    low, high = _SQUARE_RANGE_M
    if not low <= square_m <= high:
        hint = f"State metres: {square_m / 1000:g}." if square_m > high else "State metres."
        problems.append(_problem(f"A square of {square_m:g} m is not from {low:g} to {high:g} m.", hint))
    if kind == "charuco" and not 0 < marker_m < square_m:
        problems.append(_problem("A marker must be smaller than a square."))
    dictionary = match["dictionary"] or ""
    if kind == "charuco" and not hasattr(cv2.aruco, dictionary):
        names = ", ".join(name for name in dir(cv2.aruco) if name.startswith("DICT_"))
        problems.append(_problem(f"There is no dictionary {dictionary}.", f"Use one of {names}."))
    elif kind == "charuco" and (needed := cols * rows // 2) > (size := _num_markers(dictionary)):
        message = f"The board has {needed} markers, the dictionary {dictionary} has {size}."
        problems.append(_problem(message, "Check the numbers of squares and the dictionary."))
    if problems:
        raise InputError(problems)
    return Board(kind, cols, rows, square_m, marker_m, dictionary)


def _num_markers(dictionary: str) -> int:
    return len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary)).bytesList)


def _length_m(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")


def _problem(message: str, hint: str | None = None) -> Problem:
    return Problem(BOARD_INVALID, message, field="board", hint=hint)


def draw_pattern(board: Board, square: int) -> UInt8[np.ndarray, "height width"]:
    """Draw a board without its margin, ``square`` texels a square; its first inner corner is a square off each edge."""
    if board.kind == "charuco":
        pattern = np.asarray(board.charuco.generateImage((board.cols * square, board.rows * square)))
    else:
        is_first = np.indices((board.rows + 1, board.cols + 1)).sum(0) % 2 == 0
        # The square behind the first inner corner is black.
        pattern = np.where(np.kron(is_first, np.ones((square, square))) > 0, 0, 255).astype(np.uint8)
    return 255 - pattern if board.is_inverted else pattern


@lru_cache(maxsize=8)
def pattern_levels(board: Board, square: int, num_levels: int) -> tuple[Float[np.ndarray, "height width"], ...]:
    """Pattern with a margin of a square, and copies of it, each with half as many texels a side."""
    levels = [np.pad(draw_pattern(board, square), square, constant_values=board.margin_shade).astype(np.float32)]
    for _ in range(num_levels - 1):
        height, width = levels[-1].shape
        coarser = cv2.resize(levels[-1], (width // 2, height // 2), interpolation=cv2.INTER_AREA)
        levels.append(np.asarray(coarser, np.float32))
    return tuple(read_only(level) for level in levels)
