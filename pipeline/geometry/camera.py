"""Distortion, projection and rays of one camera (OpenCV's pinhole model).

The distortion model is that of OpenCV's ``calib3d`` documentation: radial k1..k6 (rational), tangential p1, p2 and thin
prism s1..s4.
"""

import numpy as np
from jaxtyping import Float

from pipeline.data import Camera

# Newton's method converges quadratically; lenses in use need 3-6 steps to reach machine precision.
_UNDISTORT_STEPS = 20


def image_from_world(camera: Camera) -> Float[np.ndarray, "3 4"]:
    """Projection matrix ``K [R | t]``, to undistorted pixels."""
    rigid = camera.cam_from_world
    return camera.matrix @ np.column_stack([rigid.rotation, rigid.translation_m])


def center_in_world(camera: Camera) -> Float[np.ndarray, " 3"]:
    """Camera centre in metres."""
    return camera.cam_from_world.inverse().translation_m


def _coefficients(distortion: Float[np.ndarray, " coefficients"]) -> Float[np.ndarray, " 12"]:
    padded = np.zeros(12)
    padded[: len(distortion)] = distortion
    return padded


def distort(
    points: Float[np.ndarray, "*batch 2"], distortion: Float[np.ndarray, " coefficients"]
) -> Float[np.ndarray, "*batch 2"]:
    """Distort points on the normalised image plane (z = 1)."""
    if not np.any(distortion):
        return points
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = _coefficients(distortion)
    x, y = points[..., 0], points[..., 1]
    r2 = x * x + y * y
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    return np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + r2 * (s1 + s2 * r2),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y + r2 * (s3 + s4 * r2),
        ],
        axis=-1,
    )


def _undistort(
    distorted: Float[np.ndarray, "*batch 2"], distortion: Float[np.ndarray, " coefficients"]
) -> Float[np.ndarray, "*batch 2"]:
    """Invert ``distort`` by Newton's method with a central-difference Jacobian."""
    if not np.any(distortion):
        return distorted
    step = 1e-6
    points = distorted.copy()
    for _ in range(_UNDISTORT_STEPS):
        residual = distort(points, distortion) - distorted
        if not np.any(np.abs(residual[np.isfinite(residual)]) > 1e-13):
            break
        column_x = (
            distort(points + np.array([step, 0.0]), distortion) - distort(points - np.array([step, 0.0]), distortion)
        ) / (2 * step)
        column_y = (
            distort(points + np.array([0.0, step]), distortion) - distort(points - np.array([0.0, step]), distortion)
        ) / (2 * step)
        determinant = column_x[..., 0] * column_y[..., 1] - column_x[..., 1] * column_y[..., 0]
        # Where the model folds over, beyond the image, the Jacobian loses its sign: stay there rather than diverge.
        determinant = np.where(determinant > 1e-3, determinant, np.inf)
        points = points - np.stack(
            [
                (column_y[..., 1] * residual[..., 0] - column_y[..., 0] * residual[..., 1]) / determinant,
                (column_x[..., 0] * residual[..., 1] - column_x[..., 1] * residual[..., 0]) / determinant,
            ],
            axis=-1,
        )
    return points


def undistort_px(camera: Camera, points_px: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
    """Map pixels as seen to the pixels of an ideal pinhole camera with the same camera matrix.

    Parameters
    ----------
    points_px
        Pixels of the full image; NaN stays NaN.
    """
    inverse = np.linalg.inv(camera.matrix)
    normalised = points_px @ inverse[:2, :2].T + inverse[:2, 2]
    return _undistort(normalised, camera.distortion) @ camera.matrix[:2, :2].T + camera.matrix[:2, 2]


def project(camera: Camera, points_m: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 2"]:
    """Project world points to pixels as seen, distortion included.

    Returns
    -------
        NaN for points behind the camera, and for NaN.
    """
    in_cam = camera.cam_from_world.apply(points_m)
    depth_m = np.where(in_cam[..., 2:] > 1e-6, in_cam[..., 2:], np.nan)
    return distort(in_cam[..., :2] / depth_m, camera.distortion) @ camera.matrix[:2, :2].T + camera.matrix[:2, 2]


def rays_in_world(camera: Camera, points_px: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 3"]:
    """Unit directions of the viewing rays through undistorted pixels, in world axes.

    A ray starts at ``center_in_world(camera)`` (Chen et al. 2020, eq. 3). NaN stays NaN.
    """
    inverse = np.linalg.inv(camera.matrix)
    normalised = points_px @ inverse[:2, :2].T + inverse[:2, 2]
    in_cam = np.concatenate([normalised, np.ones_like(normalised[..., :1])], axis=-1)
    directions = in_cam @ camera.cam_from_world.rotation
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)
