"""Fisheye lens of a camera from views of a board: poses on the undistorted image, then an adjustment of everything."""

import numpy as np
from jaxtyping import Float

from pipeline.calibration.adjustment.parameters import FOCAL
from pipeline.calibration.board.bundle import PlacedBoard, adjust_board_rig, place_board, refine_boards
from pipeline.calibration.board.poses import possible_poses
from pipeline.calibration.board.spec import Board
from pipeline.calibration.board.views import BoardViews
from pipeline.calibration.sizes import guessed_camera
from pipeline.data.arrays import read_only
from pipeline.data.cameras import Camera
from pipeline.geometry.camera import project
from pipeline.geometry.fisheye import NUM_COEFFICIENTS

FISHEYE_COEFFICIENTS = tuple(range(NUM_COEFFICIENTS))
"""Numbers of the coefficients of a fisheye lens."""
# Angles of view along the diagonal of the equidistant lenses with which the search begins.
_ANGLES_DEG = (90.0, 120.0, 150.0, 180.0, 220.0)


def fit_fisheye(views: BoardViews, board: Board) -> tuple[Camera, float] | None:
    """Fit a fisheye lens with square pixels to views (Kannala and Brandt 2006): the lens and all poses together.

    Returns
    -------
    tuple or None
        Camera at the identity, and the standard deviation of its focal length as a share of it; ``None`` if no lens of
        this kind explains most of the views.
    """
    starts = [_equidistant(views, angle_deg) for angle_deg in _ANGLES_DEG]
    placed = [_placed(start, views, board) for start in starts]
    # Of the lenses that explain the most views, the one with the least error.
    best = min(range(len(starts)), key=lambda k: (-len(placed[k]), sum(board.error_px for board in placed[k])))
    if 2 * len(placed[best]) <= len(views):
        return None
    boards = [[placed_board] for placed_board in placed[best]]
    fitted = adjust_board_rig([starts[best]], 0, boards, board, [FISHEYE_COEFFICIENTS]).adjustment
    return fitted.cameras[0], float(fitted.sigma[0, FOCAL][0])


def fisheye_errors2_px2(camera: Camera, views: BoardViews, board: Board) -> Float[np.ndarray, " corners"]:
    """Squares of the distances that remain when poses are fitted to views; infinite if a view has no pose."""
    placed = refine_boards([camera], _placed(camera, views, board), board)
    if len(placed) < len(views):
        return np.full(1, np.inf)
    projected = np.concatenate(
        [project(camera, placed_board.root_from_board.apply(board.corners_m)) for placed_board in placed]
    )
    seen_px = np.concatenate([view.corners_px[0] for view in placed])
    squares = ((projected - seen_px) ** 2).sum(-1)[np.isfinite(seen_px).all(-1)]
    return np.nan_to_num(squares, nan=np.inf)


def _equidistant(views: BoardViews, angle_deg: float) -> Camera:
    guess = guessed_camera(views.camera, views.size_px)
    focal_px = np.hypot(*views.size_px) / 2 / np.radians(angle_deg / 2)
    matrix = guess.matrix.copy()
    matrix[[0, 1], [0, 1]] = focal_px
    return Camera(
        guess.name,
        guess.size_px,
        read_only(matrix),
        read_only(np.zeros(NUM_COEFFICIENTS)),
        guess.cam_from_world,
        lens="fisheye",
    )


def _placed(camera: Camera, views: BoardViews, board: Board) -> list[PlacedBoard]:
    """Board in each view that has a pose."""
    placed = (
        place_board({0: camera}, {0: corners_px}, {0: possible_poses(camera, corners_px, board)}, board)
        for corners_px in views.corners_px
    )
    return [placed_board for placed_board in placed if placed_board is not None]
