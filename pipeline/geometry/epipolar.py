"""Two-view geometry: fundamental matrices and epipolar distances."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from pipeline.core.data.cameras import Camera


def fundamental_matrices(cameras: Sequence[Camera]) -> Float[np.ndarray, "cameras cameras 3 3"]:
    """Fundamental matrices F of undistorted pixels, ``x_left^T F x_right = 0`` with ``F = result[left, right]``.

    ``F x_right`` is the epipolar line in the left image, ``F^T x_left`` the epipolar line in the right image. Matrices
    of a camera with itself are zero.
    """
    rotations = np.array([camera.cam_from_world.rotation for camera in cameras])
    translations_m = np.array([camera.cam_from_world.translation_m for camera in cameras])
    to_normalised = np.linalg.inv(np.array([camera.matrix for camera in cameras]))
    left_from_right = rotations[:, None] @ rotations.swapaxes(-1, -2)
    tx, ty, tz = np.moveaxis(translations_m[:, None] - (left_from_right @ translations_m[..., None])[..., 0], -1, 0)
    none = np.zeros_like(tx)
    cross = np.stack([none, -tz, ty, tz, none, -tx, -ty, tx, none], axis=-1).reshape(left_from_right.shape)
    fundamentals = to_normalised.swapaxes(-1, -2)[:, None] @ cross @ left_from_right @ to_normalised
    fundamentals[np.diag_indices(len(cameras))] = 0.0
    return fundamentals


def distance_to_line_px(
    points_px: Float[np.ndarray, "*batch 2"], lines: Float[np.ndarray, "*batch 3"]
) -> Float[np.ndarray, "*batch"]:
    """Distance of points to homogeneous lines ``a x + b y + c = 0``, in pixels; NaN for NaN."""
    return np.abs((points_px * lines[..., :2]).sum(-1) + lines[..., 2]) / np.linalg.norm(lines[..., :2], axis=-1)


def epipolar_distance_px(
    fundamental: Float[np.ndarray, "3 3"],
    left_px: Float[np.ndarray, "*batch 2"],
    right_px: Float[np.ndarray, "*batch 2"],
) -> Float[np.ndarray, "*batch"]:
    """Mean distance in pixels of two points to each other's epipolar line (Chen et al. 2020, eq. 13).

    ``fundamental`` comes from ``fundamental_matrices`` for the two cameras. Pixels are undistorted; the distance is NaN
    where a point is.
    """
    ones = np.ones_like(left_px[..., :1])
    line_in_left = np.concatenate([right_px, ones], axis=-1) @ fundamental.T
    line_in_right = np.concatenate([left_px, ones], axis=-1) @ fundamental
    return (distance_to_line_px(left_px, line_in_left) + distance_to_line_px(right_px, line_in_right)) / 2
