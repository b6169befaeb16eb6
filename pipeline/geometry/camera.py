"""Distortion, projection and rays of one camera (OpenCV's pinhole model).

The standard distortion model is documented in OpenCV's ``calib3d``: radial k1..k6 (rational), tangential p1, p2 and
thin prism s1..s4. The model of fisheye lenses is in ``fisheye.py``.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.geometry.fisheye import distort_fisheye


def image_from_world(camera: Camera) -> Float[np.ndarray, "3 4"]:
    """Projection matrix ``K [R | t]`` from world coordinates in metres to undistorted pixels."""
    return camera.matrix @ camera.cam_from_world.matrix


def projection_matrices(cameras: Sequence[Camera]) -> Float[np.ndarray, "cameras 3 4"]:
    """Matrices of ``image_from_world`` of some cameras."""
    return np.array([image_from_world(camera) for camera in cameras])


def center_in_world(camera: Camera) -> Float[np.ndarray, " 3"]:
    """Camera centre in world coordinates, metres."""
    return camera.cam_from_world.inverse().translation_m


def twelve_coefficients(distortion: Float[np.ndarray, " coefficients"]) -> Float[np.ndarray, " 12"]:
    """Pad distortion coefficients to OpenCV's twelve with zeros."""
    padded = np.zeros(12)
    padded[: len(distortion)] = distortion
    return padded


def distort(
    points: Float[np.ndarray, "*batch 2"], distortion: Float[np.ndarray, " coefficients"]
) -> Float[np.ndarray, "*batch 2"]:
    """Distort points on the normalised image plane (z = 1) by the standard model; NaN stays NaN."""
    if not np.any(distortion):
        return points
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = twelve_coefficients(distortion)
    x, y = points[..., 0], points[..., 1]
    r2 = x * x + y * y
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    distorted = np.empty(points.shape)
    distorted[..., 0] = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + r2 * (s1 + s2 * r2)
    distorted[..., 1] = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y + r2 * (s3 + s4 * r2)
    return distorted


def bend(camera: Camera, points: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
    """Distort points on the normalised image plane (z = 1) by the lens; NaN beyond a fisheye's angle limit."""
    return (
        distort_fisheye(points, camera.distortion) if camera.lens == "fisheye" else distort(points, camera.distortion)
    )


def project(camera: Camera, points_m: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 2"]:
    """Project world points (metres) to distorted pixels.

    They are pixels of the full image; NaN for points behind the camera or beyond a fisheye's angle limit, and for NaN.
    """
    in_cam = camera.cam_from_world.apply(points_m)
    depth_m = np.where(in_cam[..., 2:] > 1e-6, in_cam[..., 2:], np.nan)
    return bend(camera, in_cam[..., :2] / depth_m) @ camera.matrix[:2, :2].T + camera.matrix[:2, 2]


def rays_in_world(camera: Camera, points_px: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 3"]:
    """Unit directions of the viewing rays through undistorted pixels, in world axes.

    A ray starts at ``center_in_world(camera)`` (Chen et al. 2020, eq. 3). NaN stays NaN.
    """
    inverse = np.linalg.inv(camera.matrix)
    normalised = points_px.reshape(-1, 2) @ inverse[:2, :2].T + inverse[:2, 2]
    rotation = camera.cam_from_world.rotation
    directions = normalised @ rotation[:2] + rotation[2]
    directions /= np.sqrt(1.0 + normalised[:, :1] ** 2 + normalised[:, 1:] ** 2)
    return directions.reshape(*points_px.shape[:-1], 3)


def look_at(center_m: Float[np.ndarray, " 3"], target_m: Float[np.ndarray, " 3"]) -> Rigid3:
    """Compute ``cam_from_world`` of an upright camera that looks at a point, which must not be straight up or down."""
    forward = (target_m - center_m) / np.linalg.norm(target_m - center_m)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return Rigid3(read_only(rotation), read_only(-rotation @ center_m))
