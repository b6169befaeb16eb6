"""Undistortion: from image pixels to the pixels of an ideal pinhole camera."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from pipeline.core.data.cameras import Camera
from pipeline.core.runtime.jit import zero_records
from pipeline.geometry.camera import twelve_coefficients
from pipeline.geometry.camera_kernels import block_dtype, undistort
from pipeline.geometry.fisheye import undistort_fisheye

# Newton's method converges quadratically; lenses in use need 3-6 steps to reach machine precision.
_MAX_STEPS = 20
# Tolerance on the normalised image plane.
_TOLERANCE = 1e-13
_BLOCK = 64


def undistort_px(camera: Camera, points_px: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
    """Map distorted pixels to the pixels of an ideal pinhole camera with the same camera matrix.

    Pixels are of the full image. NaN stays NaN; the result is NaN, too, where a fisheye lens sees beyond its angle
    limit.
    """
    if camera.is_ideal:
        return points_px
    inverse, coefficients = _lens(camera)
    # One large product: NumPy computes a stack of small products one by one.
    normalised = points_px.reshape(-1, 2) @ inverse[:2, :2].T + inverse[:2, 2]
    if camera.lens == "fisheye":
        normalised = undistort_fisheye(normalised, camera.distortion)
    else:
        blocks = zero_records(1, block_dtype(_BLOCK))
        undistort(normalised, coefficients, _MAX_STEPS, _TOLERANCE, blocks)
    return (normalised @ camera.matrix[:2, :2].T + camera.matrix[:2, 2]).reshape(points_px.shape)


@lru_cache(maxsize=256)  # people are undistorted by small arrays, thousands of times a session
def _lens(camera: Camera) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 12"]]:
    """Inverse camera matrix, and coefficients of the distortion as kernels take them."""
    return np.linalg.inv(camera.matrix), twelve_coefficients(camera.distortion)


def undistort_views(
    cameras: Sequence[Camera], points_px: Float[np.ndarray, "n cameras *batch 2"]
) -> Float[np.ndarray, "n cameras *batch 2"]:
    """Undistort what several cameras see, as ``undistort_px`` does for one."""
    return np.stack([undistort_px(camera, points_px[:, number]) for number, camera in enumerate(cameras)], axis=1)
