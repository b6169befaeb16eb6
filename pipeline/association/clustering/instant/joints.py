"""Triangulation of joints from matched 2D candidates by Levenberg-Marquardt (section 3.3, eq. 4)."""

import numpy as np
from jaxtyping import Float

_NUM_STEPS = 8
_FIRST_DAMPING = 1e-3
# Lower limit of reprojection errors in weights: the norm of eq. 4 has no derivative at zero.
_LEAST_ERROR_PX = 1.0


def refine(
    image_from_world: Float[np.ndarray, "cameras 3 4"],
    xyz_m: Float[np.ndarray, "joints 3"],
    points_px: Float[np.ndarray, "joints cameras 2"],
    confidence: Float[np.ndarray, "joints cameras"],
) -> Float[np.ndarray, "joints 3"]:
    """Minimise the sum of ``H(x_i) || P_i X - x_i ||`` (eq. 4) by Levenberg-Marquardt, all joints at once.

    The norm is not squared. So each step weights a view by its confidence over its error (reweighted least squares).
    The search begins at ``xyz_m``. Pixels are undistorted, and ignored where the confidence H of the view is 0: it is
    left out.
    """
    points_px = np.where(confidence[..., None] > 0, points_px, 0.0)
    damping = np.full(len(xyz_m), _FIRST_DAMPING)
    residual_px, jacobian = _linearise(image_from_world, xyz_m, points_px)
    for _ in range(_NUM_STEPS):
        error_px = np.linalg.norm(residual_px, axis=-1)
        weight = confidence / np.maximum(error_px, _LEAST_ERROR_PX)
        normal = np.einsum("kc,kcai,kcaj->kij", weight, jacobian, jacobian)
        gradient = np.einsum("kc,kcai,kca->ki", weight, jacobian, residual_px)
        normal = normal + (damping[:, None] * np.einsum("kii->ki", normal))[..., None] * np.eye(3)
        moved_m = xyz_m - np.linalg.solve(normal, gradient[..., None])[..., 0]
        moved_residual_px, moved_jacobian = _linearise(image_from_world, moved_m, points_px)
        is_better = (confidence * np.linalg.norm(moved_residual_px, axis=-1)).sum(-1) < (confidence * error_px).sum(-1)
        damping = np.where(is_better, damping * 0.1, damping * 10.0)
        xyz_m = np.where(is_better[:, None], moved_m, xyz_m)
        residual_px = np.where(is_better[:, None, None], moved_residual_px, residual_px)
        jacobian = np.where(is_better[:, None, None, None], moved_jacobian, jacobian)
    return xyz_m


def _linearise(
    image_from_world: Float[np.ndarray, "cameras 3 4"],
    xyz_m: Float[np.ndarray, "joints 3"],
    points_px: Float[np.ndarray, "joints cameras 2"],
) -> tuple[Float[np.ndarray, "joints cameras 2"], Float[np.ndarray, "joints cameras 2 3"]]:
    """Reprojection residuals in pixels, and their Jacobian in pixels a metre."""
    linear = image_from_world[:, :, :3]
    in_cam = np.einsum("cij,kj->kci", linear, xyz_m) + image_from_world[:, :, 3]
    # Avoids a division by zero for points in a camera's plane; such a camera does not see the point.
    depth = np.where(np.abs(in_cam[..., 2:]) > 1e-9, in_cam[..., 2:], 1e-9)
    projected_px = in_cam[..., :2] / depth
    jacobian = (linear[:, :2] - projected_px[..., None] * linear[:, 2:]) / depth[..., None]
    return projected_px - points_px, jacobian
