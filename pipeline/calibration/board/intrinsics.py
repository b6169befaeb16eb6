"""Intrinsics of a camera from views of a board (Zhang 2000), with the distortion model chosen by cross-validation.

A fisheye lens begins with poses on the undistorted image; then everything is adjusted.
"""

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float

from pipeline.calibration.adjustment.parameters import FOCAL
from pipeline.calibration.board.board_adjustment import PlacedBoard, adjust_board_rig, place_board, refine_boards
from pipeline.calibration.board.poses import possible_poses
from pipeline.calibration.board.spec import Board
from pipeline.calibration.board.views import BoardViews, choose_views
from pipeline.calibration.sizes import guessed_camera
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, LensModel
from pipeline.geometry.camera import project
from pipeline.geometry.fisheye import NUM_COEFFICIENTS
from pipeline.geometry.undistortion import undistort_px

MIN_VIEWS = 4
_NUM_FOLDS = 5
# Views to which the chosen model is fitted, and views with which models are compared.
_FITTED_VIEWS, _COMPARED_VIEWS = 40, 18
# A model with more coefficients must lower the error of views that it was not fitted to by this share.
_WORTH = 0.03
# Below this angle from the axis a lens is described by the standard models.
_WIDE_RAD = np.radians(40.0)
_FIXED_RADIAL = cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
FISHEYE_COEFFICIENTS = tuple(range(NUM_COEFFICIENTS))
"""Numbers of the coefficients of a fisheye lens."""
# Angles of view along the diagonal of the equidistant lenses with which the search begins.
_ANGLES_DEG = (90.0, 120.0, 150.0, 180.0, 220.0)


@dataclass(frozen=True, slots=True)
class DistortionModel:
    """Distortion model of a camera."""

    name: str  # Name in the report
    flags: int  # Flags of ``cv2.calibrateCamera``; none for a fisheye lens
    free: tuple[int, ...]  # Numbers of the coefficients that are not zero, in OpenCV's order
    length: int  # Number of coefficients that a camera has then
    lens: LensModel = "standard"  # OpenCV's model that the coefficients are of


MODELS = (
    DistortionModel("none", _FIXED_RADIAL | cv2.CALIB_ZERO_TANGENT_DIST, (), 0),
    DistortionModel("k1", cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST, (0,), 4),
    DistortionModel("k1, k2", cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST, (0, 1), 4),
    DistortionModel("k1, k2, p1, p2", cv2.CALIB_FIX_K3, (0, 1, 2, 3), 4),
    DistortionModel("k1, k2, p1, p2, k3", 0, (0, 1, 2, 3, 4), 5),
    DistortionModel("rational, 8 coefficients", cv2.CALIB_RATIONAL_MODEL, (0, 1, 2, 3, 4, 5, 6, 7), 8),
    DistortionModel("fisheye, 4 coefficients", 0, FISHEYE_COEFFICIENTS, NUM_COEFFICIENTS, "fisheye"),
)
"""Models, the simplest first."""


@dataclass(frozen=True, slots=True, eq=False)
class Intrinsics:
    """Intrinsics of a camera."""

    camera: Camera  # Camera at the identity
    model: DistortionModel  # Chosen distortion model
    error_px: float  # Root mean square distance of the corners from their projections
    focal_sigma: float  # Standard deviation of the focal length as a share of it


def calibrate_intrinsics(views: BoardViews, board: Board) -> Intrinsics:
    """Calibrate a camera with square pixels from at least ``MIN_VIEWS`` views, of which some are chosen."""
    compared = views.select(choose_views(views, _COMPARED_VIEWS))
    held_out = [_held_out_error_px(compared, board, model) for model in MODELS if model.lens == "standard"]
    if _is_wide(compared, board):
        held_out += [_held_out_error_px(compared, board, model) for model in MODELS if model.lens == "fisheye"]
    limit_px = min(held_out) * (1 + _WORTH)
    number = next((k for k, error_px in enumerate(held_out) if error_px <= limit_px), 2)
    fitted_to = views.select(choose_views(views, _FITTED_VIEWS))
    camera, focal_sigma = _adjusted(fitted_to, board, MODELS[number])
    error_px = float(np.sqrt(_errors2_px2(camera, fitted_to, board).mean()))
    return Intrinsics(camera, MODELS[number], error_px, focal_sigma)


def _adjusted(views: BoardViews, board: Board, model: DistortionModel) -> tuple[Camera, float]:
    """Camera at the identity, and the standard deviation of its focal length as a share of it."""
    if model.lens == "fisheye" and (fitted := fit_fisheye(views, board)) is not None:
        return fitted
    if model.lens == "fisheye":
        model = MODELS[2]
    camera, _ = _fit_standard(views, board, model)
    boards = [[placed_board] for placed_board in _placed(camera, views, board)]
    adjusted = adjust_board_rig([camera], 0, boards, board, [model.free]).adjustment
    return adjusted.cameras[0], float(adjusted.sigma[0, FOCAL][0])


def _is_wide(views: BoardViews, board: Board) -> bool:
    """True if corners are seen at an angle from the axis at which lens models differ."""
    camera, _ = _fit_standard(views, board, MODELS[2])
    corners_px = np.concatenate(_points(views, board)[1]).astype(float)
    ideal = np.linalg.norm((undistort_px(camera, corners_px) - camera.matrix[:2, 2]) / camera.matrix[0, 0], axis=-1)
    return not np.all(np.arctan(ideal) < _WIDE_RAD)


def _held_out_error_px(views: BoardViews, board: Board, model: DistortionModel) -> float:
    """Cross-validated error of a model: a view's pose is fitted to it, its intrinsics come from other views."""
    num_folds = min(_NUM_FOLDS, len(views))
    number = np.arange(len(views))
    squares: list[Float[np.ndarray, " corners"]] = []
    for fold in range(num_folds):
        kept, left_out = number[number % num_folds != fold], number[fold::num_folds]
        if len(kept) < MIN_VIEWS - 1:
            return float("nan")
        fitted = _fit(views.select(kept), board, model)
        squares.append(np.full(1, np.inf) if fitted is None else _errors2_px2(fitted[0], views.select(left_out), board))
    return float(np.sqrt(np.concatenate(squares).mean()))


def _fit(views: BoardViews, board: Board, model: DistortionModel) -> tuple[Camera, float] | None:
    """Camera at the identity, and the standard deviation of its focal length as a share of it."""
    return fit_fisheye(views, board) if model.lens == "fisheye" else _fit_standard(views, board, model)


def _errors2_px2(camera: Camera, views: BoardViews, board: Board) -> Float[np.ndarray, " corners"]:
    """Squares of the distances that remain when poses are fitted to views."""
    if camera.lens == "fisheye":
        return fisheye_errors2_px2(camera, views, board)
    distortion = camera.distortion if len(camera.distortion) else np.zeros(4)
    squares: list[Float[np.ndarray, " corners"]] = []
    for points_m, points_px in zip(*_points(views, board), strict=True):
        _, turn, shift_m = cv2.solvePnP(points_m, points_px, camera.matrix, distortion, flags=cv2.SOLVEPNP_IPPE)
        turn, shift_m = cv2.solvePnPRefineLM(points_m, points_px, camera.matrix, distortion, turn, shift_m)
        projected, _ = cv2.projectPoints(points_m, turn, shift_m, camera.matrix, distortion)
        squares.append(((projected.reshape(-1, 2) - points_px) ** 2).sum(-1))
    return np.concatenate(squares)


def _points(views: BoardViews, board: Board) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Corners of each view that were found: on the board, metres, and in the picture, pixels."""
    seen = [np.isfinite(corners_px).all(-1) for corners_px in views.corners_px]
    points_m = [board.corners_m[mask].astype(np.float32) for mask in seen]
    return points_m, [
        corners_px[mask].astype(np.float32) for corners_px, mask in zip(views.corners_px, seen, strict=True)
    ]


def _fit_standard(views: BoardViews, board: Board, model: DistortionModel) -> tuple[Camera, float]:
    guess = guessed_camera(views.camera, views.size_px)
    points_m, points_px = _points(views, board)
    flags = model.flags | cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_ASPECT_RATIO
    begin: Any = guess.matrix.copy()
    _, matrix, distortion, _, _, sigma, _, _ = cv2.calibrateCameraExtended(
        points_m, points_px, views.size_px, begin, np.zeros(max(5, model.length)), flags=flags
    )
    matrix, distortion = np.asarray(matrix, float), np.asarray(distortion, float).ravel()[: model.length]
    camera = replace(guess, matrix=read_only(matrix), distortion=read_only(distortion.copy()))
    return camera, float(np.ravel(sigma)[:2].max() / matrix[0, 0])


def fit_fisheye(views: BoardViews, board: Board) -> tuple[Camera, float] | None:
    """Fit a fisheye lens with square pixels to views (Kannala and Brandt 2006): the lens and all poses together.

    Returns the camera at the identity, and the standard deviation of its focal length as a share of it; ``None`` if no
    lens of this kind explains most of the views.
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
    placed = (
        place_board({0: camera}, {0: corners_px}, {0: possible_poses(camera, corners_px, board)}, board)
        for corners_px in views.corners_px
    )
    return [placed_board for placed_board in placed if placed_board is not None]
