"""Corners of a board, refined by aligning its pattern with the picture around each of them.

Gradients around a corner of a ChArUco board include the edges of its markers, which pull ``cv2.cornerSubPix`` by up to
a pixel where squares are small. Here the markers are part of the model: the pattern is drawn as the camera would see
it, and shifted until it fits (Lucas and Kanade 1981, "An iterative image registration technique with an application to
stereo vision").
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from pipeline.calibration.board.spec import Board, pattern_levels

# Half of the side of the window around a corner, in squares, and its limits in pixels.
_WINDOW_SQUARES, _WINDOW_PX = 0.5, (4, 40)
# Pixels around the window that are drawn too, for derivatives and blur.
_MARGIN_PX = 5
# The pattern is drawn this many times finer than the picture and shrunk, from texels of about the same size.
_SUPERSAMPLING = 2
_SQUARE_TEXELS, _NUM_LEVELS = 128, 6
_MIN_BLUR_PX = 0.5
_MAX_STEPS, _SMALL_STEP_PX, _LARGE_STEP_PX = 10, 0.02, 1.0
# A corner is found if picture and pattern correlate at least so much, and if it moved by less than this share of a
# square.
_MIN_CORRELATION, _MAX_MOVE_SQUARES = 0.9, 0.3
_MIN_CONTRAST = 0.02
_MIN_HOMOGRAPHY_POINTS = 4


class _Window(NamedTuple):
    """Pattern and picture in the window around a corner, as columns of pixels."""

    by_shift: Float[np.ndarray, "pixels 2"]
    pattern: Float[np.ndarray, " pixels"]
    curvature: Float[np.ndarray, " pixels"]
    picture: Float[np.ndarray, " pixels"]


def align_corners(
    gray: UInt8[np.ndarray, "height width"],
    corners_px: Float[np.ndarray, "corners 2"],
    board: Board,
    edge_px: float,
) -> Float[np.ndarray, "corners 2"]:
    """Align the corners that a detector found, and find those that it missed.

    Pixels are by number of the corner, NaN where none was found, and in the result where the picture does not look like
    the board. ``edge_px`` is the width of the edges between squares.
    """
    picture = gray.astype(np.float32)
    # The width of a step that is blurred by a Gaussian, contrast over slope, is sqrt(2 pi) standard deviations.
    blur_px = max(_MIN_BLUR_PX, edge_px / np.sqrt(2 * np.pi))
    aligned = np.full(corners_px.shape, np.nan)
    if (picture_from_board := _homography(corners_px, board)) is None:
        return aligned
    for k in np.flatnonzero(np.isfinite(corners_px).all(-1)):
        aligned[k] = _align(picture, corners_px[k], _grid(board)[k], board, picture_from_board, blur_px)
    if (picture_from_board := _homography(aligned, board)) is None:
        return aligned
    predicted_px = cv2.perspectiveTransform(_grid(board)[None], picture_from_board)[0]
    for k in np.flatnonzero(np.isnan(aligned).any(-1)):
        aligned[k] = _align(picture, predicted_px[k], _grid(board)[k], board, picture_from_board, blur_px)
    return aligned


def _grid(board: Board) -> Float[np.ndarray, "corners 2"]:
    """Corners in squares from the edges of the pattern."""
    across, down = board.corner_counts
    return 1.0 + np.stack(np.meshgrid(np.arange(across), np.arange(down)), axis=-1).reshape(-1, 2)


def _homography(corners_px: Float[np.ndarray, "corners 2"], board: Board) -> Float[np.ndarray, "3 3"] | None:
    """Homography from the pattern, in squares, to the picture."""
    seen = np.isfinite(corners_px).all(-1)
    if seen.sum() < _MIN_HOMOGRAPHY_POINTS:
        return None
    homography, _ = cv2.findHomography(_grid(board)[seen], corners_px[seen])
    return (
        None
        if homography is None or abs(np.linalg.det(homography)) < np.finfo(float).eps
        else np.asarray(homography, float)
    )


def _align(
    picture: Float[np.ndarray, "height width"],
    start_px: Float[np.ndarray, " 2"],
    corner: Float[np.ndarray, " 2"],
    board: Board,
    picture_from_board: Float[np.ndarray, "3 3"],
    blur_px: float,
) -> Float[np.ndarray, " 2"]:
    """Shift the pattern until it fits the picture around a corner; NaN if it does not.

    Brightness, contrast and the rest of the blur are fitted with the shift: all of them are linear.
    """
    around = np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]) + corner
    middle_px, *ends_px = cv2.perspectiveTransform(around[None], picture_from_board)[0]
    arms_px = np.array(ends_px) - middle_px
    side_px = float(np.linalg.norm(arms_px, axis=-1).min())
    half = np.clip(np.ceil(_WINDOW_SQUARES * np.abs(arms_px).max(0)), *_WINDOW_PX).astype(int)
    place_px, nowhere = start_px.copy(), np.full(2, np.nan)
    share, last_px = 1.0, np.zeros(2)
    for _ in range(_MAX_STEPS):
        shifted = _shift(*(place_px - middle_px)) @ picture_from_board
        window = _window(picture, np.round(place_px).astype(int), half, board, shifted, side_px, blur_px)
        if window is None:
            return nowhere
        columns = np.column_stack([window.by_shift, window.pattern, np.ones_like(window.pattern), window.curvature])
        solution = np.linalg.lstsq(columns.T @ columns, columns.T @ window.picture, rcond=None)[0]
        if solution[2] < _MIN_CONTRAST:
            return nowhere
        step_px = solution[:2] / solution[2]
        length_px = float(np.linalg.norm(step_px))
        # Cameras that sharpen have steeper edges than the pattern that is drawn: whole steps would swing for ever.
        share *= 0.5 if step_px @ last_px < 0 else 1.0
        last_px = step_px
        place_px = place_px + step_px * min(share, _LARGE_STEP_PX / max(length_px, _SMALL_STEP_PX))
        if np.linalg.norm(place_px - start_px) > max(1.0, _MAX_MOVE_SQUARES * side_px):
            return nowhere
        if length_px < _SMALL_STEP_PX:
            # Not by matmul, whose kernels may warn of values beyond the array.
            fitted = (columns * solution).sum(1)
            correlation = np.corrcoef(fitted, window.picture)[0, 1]
            return place_px if correlation >= _MIN_CORRELATION else nowhere
    return nowhere


def _shift(x_px: float, y_px: float) -> Float[np.ndarray, "3 3"]:
    return np.array([[1.0, 0.0, x_px], [0.0, 1.0, y_px], [0.0, 0.0, 1.0]])


def _window(
    picture: Float[np.ndarray, "height width"],
    middle: np.ndarray,
    half: np.ndarray,
    board: Board,
    picture_from_board: Float[np.ndarray, "3 3"],
    side_px: float,
    blur_px: float,
) -> _Window | None:
    """Draw the pattern in a window of the picture; ``None`` if half of the window is beyond the picture."""
    low, high = np.maximum(middle - half, 0), np.minimum(middle + half + 1, picture.shape[::-1])
    if (high <= middle).any() or (low > middle).any() or 2 * (high - low).prod() < (2 * half + 1).prod():
        return None
    drawn = cv2.GaussianBlur(
        _drawn(board, picture_from_board, low - _MARGIN_PX, high + _MARGIN_PX, side_px), (0, 0), blur_px
    )
    inner = slice(_MARGIN_PX - 1, 1 - _MARGIN_PX)
    drawn = drawn[inner, inner]
    left, right, up, down = drawn[1:-1, :-2], drawn[1:-1, 2:], drawn[:-2, 1:-1], drawn[2:, 1:-1]
    within = drawn[1:-1, 1:-1]
    # A pattern that moves to the right darkens where it brightens to the right.
    by_shift = np.column_stack([((left - right) / 2).ravel(), ((up - down) / 2).ravel()])
    curvature = (left + right + up + down - 4 * within).ravel()
    return _Window(by_shift, within.ravel(), curvature, picture[low[1] : high[1], low[0] : high[0]].ravel())


def _drawn(
    board: Board, picture_from_board: Float[np.ndarray, "3 3"], low: np.ndarray, high: np.ndarray, side_px: float
) -> Float[np.ndarray, "height width"]:
    """Draw the pattern in the pixels from ``low`` to ``high``."""
    wanted = np.log2(_SQUARE_TEXELS / (_SUPERSAMPLING * max(side_px, 1.0)))
    level = int(np.clip(np.floor(wanted), 0, _NUM_LEVELS - 1))
    texels = _SQUARE_TEXELS >> level
    scale = 1.0 / _SUPERSAMPLING
    picture_from_fine = _shift(*(low + scale / 2 - 0.5)) @ np.diag([scale, scale, 1.0])
    texel_from_board = _shift(texels - 0.5, texels - 0.5) @ np.diag([texels, texels, 1.0])
    width, height = (high - low).tolist()
    fine = cv2.warpPerspective(
        pattern_levels(board, _SQUARE_TEXELS, _NUM_LEVELS)[level],
        texel_from_board @ np.linalg.inv(picture_from_board) @ picture_from_fine,
        (width * _SUPERSAMPLING, height * _SUPERSAMPLING),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=board.margin_shade,
    )
    return np.asarray(cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA))
