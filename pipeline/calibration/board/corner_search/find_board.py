"""Corners of a board in a picture, by OpenCV."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from pipeline.calibration.board.corner_search.corners import align_corners
from pipeline.calibration.board.corner_search.numbering import number_corners
from pipeline.calibration.board.corner_search.squares import find_grids
from pipeline.calibration.board.spec import Board

# Larger pictures are shrunk for the search of chessboards; corners are then refined in the full picture.
_SEARCHED_PX = 1280
_MIN_CORNERS = 6


class DetectedBoard(NamedTuple):
    """Board in a picture."""

    corners_px: Float[np.ndarray, "corners 2"]  # Pixels by number of the corner; NaN where a corner was not found
    sharpness_px: float  # Mean width of the edges between squares
    board: Board  # Board that was found, of those that were looked for
    # The board was only found in the mirrored picture; the corners then are of no use
    is_mirrored: bool = False
    # No other of the boards explains the picture as well: a part of a board may be of two of its prints, a column apart
    is_sure: bool = True

    @property
    def num_found(self) -> int:
        """Number of the corners that were found."""
        return int(np.isfinite(self.corners_px).all(-1).sum())


def find_board(image: UInt8[np.ndarray, "height width 3"], *boards: Board) -> DetectedBoard | None:
    """Find a board in an RGB picture; ``None`` if it is not there.

    Chessboards must be seen whole (sector-based detector, Duda and Frese 2018), ChArUco boards in part. Of several
    boards, prints of one (``Board.prints``), the one is found of which the picture shows the most corners.
    """
    gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    if boards[0].kind == "chessboard":
        return _find_chessboard(gray, boards)
    return _find_charuco(gray, boards)


def is_exchanged(image: UInt8[np.ndarray, "height width 3"], board: Board) -> bool:
    """Return whether the picture shows the ChArUco board with its numbers of columns and rows exchanged.

    A chessboard looks the same then, and is found.
    """
    if board.kind == "chessboard" or board.cols == board.rows:
        return False
    gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return next(_found_by_markers(gray, board.exchanged.prints), None) is not None


def _find_chessboard(gray: np.ndarray, boards: Sequence[Board]) -> DetectedBoard | None:
    factor = min(1.0, _SEARCHED_PX / max(gray.shape))
    small = gray if factor == 1.0 else cv2.resize(gray, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    pattern = (boards[0].cols, boards[0].rows)
    is_found, corners = cv2.findChessboardCornersSB(small, pattern, flags=cv2.CALIB_CB_EXHAUSTIVE)
    # The other detector wants dark squares on light ground.
    for shaded in (small, 255 - small):
        if not is_found:
            is_found, corners = cv2.findChessboardCorners(
                shaded, pattern, flags=cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_FAST_CHECK
            )
    if not is_found:
        return None
    corners_px = (corners.reshape(-1, 2).astype(float) + 0.5) / factor - 0.5
    aligned = (_aligned(gray, _numbered(gray, corners_px, board), board) for board in boards)
    return next((detected for detected in aligned if detected is not None), None)


def _aligned(gray: np.ndarray, corners_px: np.ndarray, board: Board) -> DetectedBoard | None:
    """Board with its corners aligned; ``None`` if too few of them look like corners of the board."""
    edge_px = _edge_px(gray, corners_px[np.isfinite(corners_px).all(-1)])
    aligned = align_corners(gray, corners_px, board, edge_px)
    detected = DetectedBoard(aligned, edge_px, board)
    is_enough = detected.num_found >= min(_MIN_CORNERS, board.num_corners)
    return detected if is_enough and _spread(aligned) else None


def _numbered(gray: np.ndarray, corners_px: np.ndarray, board: Board) -> np.ndarray:
    """Number corners so that x runs to the right of y as seen from in front, and the first square is black.

    Detectors may begin at any outer corner. Of an ambiguous board, two numberings remain: of a square one, those that
    begin at black squares.
    """
    grid = corners_px.reshape(board.rows, board.cols, 2)
    across, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    if across[0] * down[1] - across[1] * down[0] < 0:
        grid = grid[:, ::-1]
    if board.is_ambiguous and board.cols != board.rows:
        return grid.reshape(-1, 2)
    if _first_cell_is_white(gray, grid):
        grid = np.rot90(grid, 1 if board.is_ambiguous else 2)
    return grid.reshape(-1, 2)


def _first_cell_is_white(gray: np.ndarray, grid: np.ndarray) -> bool:
    """Compare the square behind the first corner with its neighbours, at their centres, all over the board."""
    centres_px = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4
    x_px, y_px = np.moveaxis(centres_px.astype(np.float32), -1, 0)
    shades = cv2.remap(gray, x_px, y_px, cv2.INTER_LINEAR).astype(float)
    is_like_first = np.indices(shades.shape).sum(0) % 2 == 0
    return bool(shades[is_like_first].mean() > shades[~is_like_first].mean())


def _find_charuco(gray: np.ndarray, boards: Sequence[Board]) -> DetectedBoard | None:
    if found := [*_found_by_markers(gray, boards)] or _found_by_squares(gray, boards):
        best = max(found, key=lambda detected: detected.num_found)
        is_sure = sum(detected.num_found == best.num_found for detected in found) == 1
        return best._replace(is_sure=is_sure)
    for board, mirrored in _by_markers(np.ascontiguousarray(gray[:, ::-1]), boards):
        return DetectedBoard(mirrored, np.nan, board, is_mirrored=True)
    return None


def _found_by_markers(gray: np.ndarray, boards: Sequence[Board]) -> Iterator[DetectedBoard]:
    """Find ChArUco boards of which markers can be read one by one."""
    for board, corners_px in _by_markers(gray, boards):
        if (detected := _aligned(gray, corners_px, board)) is not None:
            yield detected


def _found_by_squares(gray: np.ndarray, boards: Sequence[Board]) -> list[DetectedBoard]:
    """Find a ChArUco board of which few markers can be read one by one: blurred, noisy or small."""
    for grid in find_grids(gray):
        numbered = [(board, number_corners(gray, grid, board)) for board in boards]
        found = [_aligned(gray, corners_px, board) for board, corners_px in numbered if corners_px is not None]
        if found:
            return [detected for detected in found if detected is not None]
    return []


def _by_markers(gray: np.ndarray, boards: Sequence[Board]) -> Iterator[tuple[Board, np.ndarray]]:
    """Boards of which enough corners lie between markers that can be read one by one, with these corners."""
    shaded = {False: gray, True: 255 - gray}
    markers: dict[bool, Sequence[Any]] = {}
    for board in boards:
        # Markers of boards with other places for them are the same.
        known = markers.get(board.is_inverted, (None, None))
        detector = cv2.aruco.CharucoDetector(board.charuco)
        corners, ids, *markers[board.is_inverted] = detector.detectBoard(shaded[board.is_inverted], None, None, *known)
        if ids is None or len(ids) < _MIN_CORNERS:
            continue
        corners_px = np.full((board.num_corners, 2), np.nan)
        corners_px[ids.ravel()] = corners.reshape(-1, 2)
        if _spread(corners_px):
            yield board, corners_px


def _spread(corners_px: np.ndarray) -> bool:
    """Return whether corners are more than a line: a line determines no pose."""
    seen = corners_px[np.isfinite(corners_px).all(-1)]
    widths = np.linalg.svd(seen - seen.mean(0), compute_uv=False)
    return bool(widths[1] > 0.05 * widths[0])


def _edge_px(gray: np.ndarray, corners_px: np.ndarray, half: int = 6) -> float:
    """Width of edges around corners: contrast over the steepest slope."""
    height, width = gray.shape
    widths = []
    for x, y in np.round(corners_px).astype(int):
        patch = gray[max(0, y - half) : min(height, y + half + 1), max(0, x - half) : min(width, x + half + 1)]
        patch = patch.astype(float)
        slope = max(np.abs(np.diff(patch, axis=axis)).max(initial=0.0) for axis in (0, 1))
        widths.append(np.ptp(patch) / max(slope, 1.0))
    return float(np.median(widths))
