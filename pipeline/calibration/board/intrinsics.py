"""Intrinsics of a camera from views of a board (Zhang 2000), with the distortion model chosen by cross-validation."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float

from pipeline.calibration.board.spec import Board
from pipeline.calibration.board.views import BoardViews, choose_views
from pipeline.calibration.guess import guessed_camera
from pipeline.data import Camera, read_only
from pipeline.geometry.rigid import Rigid3

MIN_VIEWS = 4
_NUM_FOLDS = 5
# Views to which the chosen model is fitted, and views with which models are compared.
_FITTED_VIEWS, _COMPARED_VIEWS = 40, 18
# A model with more coefficients must lower the error of views that it was not fitted to by this share.
_WORTH = 0.03
_FIXED_RADIAL = cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3


@dataclass(frozen=True, slots=True)
class DistortionModel:
    """Distortion model of a camera.

    Parameters
    ----------
    name
        What the report calls it.
    flags
        Flags of ``cv2.calibrateCamera``.
    free
        Numbers of the coefficients that are not zero, in OpenCV's order.
    length
        Number of coefficients that a camera has then.
    """

    name: str
    flags: int
    free: tuple[int, ...]
    length: int


MODELS = (
    DistortionModel("none", _FIXED_RADIAL | cv2.CALIB_ZERO_TANGENT_DIST, (), 0),
    DistortionModel("k1", cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST, (0,), 4),
    DistortionModel("k1, k2", cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST, (0, 1), 4),
    DistortionModel("k1, k2, p1, p2", cv2.CALIB_FIX_K3, (0, 1, 2, 3), 4),
    DistortionModel("k1, k2, p1, p2, k3", 0, (0, 1, 2, 3, 4), 5),
    DistortionModel("rational, 8 coefficients", cv2.CALIB_RATIONAL_MODEL, (0, 1, 2, 3, 4, 5, 6, 7), 8),
)
"""Models, the simplest first."""


@dataclass(frozen=True, slots=True, eq=False)
class Intrinsics:
    """Intrinsics of a camera.

    Parameters
    ----------
    camera
        Camera at the identity.
    model
        Chosen distortion model.
    error_px
        Root mean square distance of the corners from their projections.
    held_out_error_px
        The same, of views that the model was not fitted to; NaN if there were too few views.
    focal_sigma
        Standard deviation of the focal length as a share of it.
    """

    camera: Camera
    model: DistortionModel
    error_px: float
    held_out_error_px: float
    focal_sigma: float


def calibrate_intrinsics(views: BoardViews, board: Board) -> Intrinsics:
    """Calibrate a camera with square pixels from at least ``MIN_VIEWS`` views, of which some are chosen."""
    few = _points(views.select(choose_views(views, _COMPARED_VIEWS)), board)
    held_out = [_held_out_error_px(*few, views.size_px, model) for model in MODELS]
    limit_px = min(held_out) * (1 + _WORTH)
    number = next((k for k, error_px in enumerate(held_out) if error_px <= limit_px), 2)
    model = MODELS[number]
    all_points = _points(views.select(choose_views(views, _FITTED_VIEWS)), board)
    error_px, matrix, distortion, sigma = _fit(*all_points, views.size_px, model)
    camera = Camera(
        views.camera,
        views.size_px,
        read_only(matrix),
        read_only(distortion[: model.length].copy()),
        Rigid3(read_only(np.eye(3)), read_only(np.zeros(3))),
    )
    return Intrinsics(camera, model, error_px, held_out[number], float(sigma[:2].max() / matrix[0, 0]))


def _points(views: BoardViews, board: Board) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Corners of each view that were found: on the board, metres, and in the picture, pixels."""
    seen = [np.isfinite(one).all(-1) for one in views.corners_px]
    points_m = [board.corners_m[mask].astype(np.float32) for mask in seen]
    return points_m, [one[mask].astype(np.float32) for one, mask in zip(views.corners_px, seen, strict=True)]


def _held_out_error_px(
    points_m: Sequence[np.ndarray], points_px: Sequence[np.ndarray], size_px: tuple[int, int], model: DistortionModel
) -> float:
    """Cross-validated error of a model: a view's pose is fitted to it, its intrinsics are those of other views."""
    num_folds = min(_NUM_FOLDS, len(points_m))
    squares, count = 0.0, 0
    for fold in range(num_folds):
        kept = [k for k in range(len(points_m)) if k % num_folds != fold]
        if len(kept) < MIN_VIEWS - 1:
            return float("nan")
        _, matrix, distortion, _ = _fit([points_m[k] for k in kept], [points_px[k] for k in kept], size_px, model)
        for k in range(fold, len(points_m), num_folds):
            error2_px2 = _pose_error2_px2(points_m[k], points_px[k], matrix, distortion)
            squares, count = squares + error2_px2.sum(), count + len(error2_px2)
    return float(np.sqrt(squares / count))


def _pose_error2_px2(
    points_m: np.ndarray, points_px: np.ndarray, matrix: np.ndarray, distortion: np.ndarray
) -> Float[np.ndarray, " points"]:
    """Squares of the distances that remain when a pose is fitted to a view."""
    _, turn, shift_m = cv2.solvePnP(points_m, points_px, matrix, distortion, flags=cv2.SOLVEPNP_IPPE)
    turn, shift_m = cv2.solvePnPRefineLM(points_m, points_px, matrix, distortion, turn, shift_m)
    projected, _ = cv2.projectPoints(points_m, turn, shift_m, matrix, distortion)
    squares: np.ndarray = ((projected.reshape(-1, 2) - points_px) ** 2).sum(-1)
    return squares


def _fit(
    points_m: Sequence[np.ndarray], points_px: Sequence[np.ndarray], size_px: tuple[int, int], model: DistortionModel
) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
    """Error, camera matrix, distortion coefficients and standard deviations of the intrinsics."""
    flags = model.flags | cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_ASPECT_RATIO
    begin: Any = guessed_camera("", size_px).matrix.copy()
    error_px, matrix, distortion, _, _, sigma, _, _ = cv2.calibrateCameraExtended(
        points_m, points_px, size_px, begin, np.zeros(max(5, model.length)), flags=flags
    )
    return error_px, np.asarray(matrix, float), np.asarray(distortion, float).ravel(), np.asarray(sigma).ravel()
