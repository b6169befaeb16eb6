"""Two-view geometry: fundamental matrices and epipolar distances."""

import numpy as np
from jaxtyping import Float

from pipeline.data import Camera


def fundamental_matrix(left: Camera, right: Camera) -> Float[np.ndarray, "3 3"]:
    """Fundamental matrix F of undistorted pixels, ``x_left^T F x_right = 0``.

    ``F x_right`` is the epipolar line in the left image, ``F^T x_left`` the one in the right.
    """
    left_from_right = left.cam_from_world @ right.cam_from_world.inverse()
    tx, ty, tz = left_from_right.translation_m
    cross = np.array([[0.0, -tz, ty], [tz, 0.0, -tx], [-ty, tx, 0.0]])
    essential = cross @ left_from_right.rotation
    return np.linalg.inv(left.matrix).T @ essential @ np.linalg.inv(right.matrix)


def distance_to_line_px(
    points_px: Float[np.ndarray, "*batch 2"], lines: Float[np.ndarray, "*batch 3"]
) -> Float[np.ndarray, "*batch"]:
    """Distance of points to homogeneous lines ``a x + b y + c = 0`` in pixels."""
    return np.abs((points_px * lines[..., :2]).sum(-1) + lines[..., 2]) / np.linalg.norm(lines[..., :2], axis=-1)


def epipolar_distance_px(
    fundamental: Float[np.ndarray, "3 3"],
    left_px: Float[np.ndarray, "*batch 2"],
    right_px: Float[np.ndarray, "*batch 2"],
) -> Float[np.ndarray, "*batch"]:
    """Mean of the two point-to-epipolar-line distances (Chen et al. 2020, eq. 13), undistorted pixels.

    NaN where a point is NaN.
    """
    ones = np.ones_like(left_px[..., :1])
    line_in_left = np.concatenate([right_px, ones], axis=-1) @ fundamental.T
    line_in_right = np.concatenate([left_px, ones], axis=-1) @ fundamental
    return (distance_to_line_px(left_px, line_in_left) + distance_to_line_px(right_px, line_in_right)) / 2
