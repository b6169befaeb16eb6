"""Pattern of a board as a picture."""

from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from pipeline.calibration.board.spec import Board
from pipeline.data import read_only


def draw_pattern(board: Board, square: int) -> UInt8[np.ndarray, "height width"]:
    """Draw a board without its margin, ``square`` texels a square; its first inner corner is a square off each edge."""
    if board.kind == "charuco":
        return np.asarray(board.charuco.generateImage((board.cols * square, board.rows * square)))
    is_first = np.indices((board.rows + 1, board.cols + 1)).sum(0) % 2 == 0
    # The square behind the first inner corner is black.
    return np.where(np.kron(is_first, np.ones((square, square))) > 0, 0, 255).astype(np.uint8)


@lru_cache(maxsize=8)
def pattern_levels(board: Board, square: int, num_levels: int) -> tuple[Float[np.ndarray, "height width"], ...]:
    """Pattern with a white margin of a square, and copies of it, each with half as many texels a side."""
    levels = [np.pad(draw_pattern(board, square), square, constant_values=255).astype(np.float32)]
    for _ in range(num_levels - 1):
        height, width = levels[-1].shape
        coarser = cv2.resize(levels[-1], (width // 2, height // 2), interpolation=cv2.INTER_AREA)
        levels.append(np.asarray(coarser, np.float32))
    return tuple(read_only(level) for level in levels)
