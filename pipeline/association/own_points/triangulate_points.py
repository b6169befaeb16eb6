"""Triangulate points of the user's own, with standard deviations from their residuals."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.data.people import Source, Track3D
from pipeline.geometry.camera import projection_matrices
from pipeline.geometry.track_assembly import close_gaps, make_person
from pipeline.geometry.tracks import reproject, triangulate_frames
from pipeline.geometry.triangulation import DISPUTED_M
from pipeline.geometry.undistortion import undistort_views

# Least deviation of a point in a picture.
_MIN_SIGMA_PX = 0.5


def locate_points(
    cameras: Sequence[Camera],
    timebase: Timebase,
    track: Track3D,
    points_px: Float[np.ndarray, "frames cameras points 2"],
    score: Float[np.ndarray, "frames cameras points"],
    min_score: float,
) -> Track3D:
    """Triangulate points robustly in the frames of a track, with standard deviations.

    Pixels are distorted, NaN where a camera does not see a point.
    """
    matrices, ideal_px = projection_matrices(cameras), undistort_views(cameras, points_px)
    xyz_m = triangulate_frames(matrices, ideal_px, score, min_score)
    used, sigma_m = np.zeros(score.shape), np.full(xyz_m.shape[:2], np.nan)
    for k in range(xyz_m.shape[1]):  # the derivatives of all points at once would take much memory
        jacobian, residual_px = _views(matrices, xyz_m[:, k], ideal_px[:, :, k])
        # A metre at the point has this length in the picture, in pixels.
        scale_px_m = np.sqrt((jacobian**2).sum((-2, -1)) / 2.0)
        agrees = np.linalg.norm(residual_px, axis=-1) <= DISPUTED_M * scale_px_m
        agrees &= (score[:, :, k] > 0) & (score[:, :, k] >= min_score)
        agrees &= agrees.sum(1, keepdims=True) >= 2
        is_known = agrees.any(1)
        xyz_m[~is_known, k] = np.nan
        used[:, :, k] = np.where(agrees, score[:, :, k], 0.0)
        if is_known.any():
            sigma_m[is_known, k] = _sigma_m(jacobian[is_known], residual_px[is_known], agrees[is_known])
            sigma_m[:, k] = np.interp(np.arange(len(xyz_m)), np.flatnonzero(is_known), sigma_m[is_known, k])
    source = close_gaps(timebase, xyz_m)
    sigma_m[source == Source.ABSENT] = np.nan
    seen_px = np.where(used[..., None] > 0, points_px, np.nan)
    located, _ = make_person(track.start_frame, xyz_m, source, reproject(cameras, xyz_m, seen_px, used), seen_px, used)
    return replace(located, track_id=track.track_id, uncertainty_m=read_only(sigma_m))


def _views(
    matrices: Float[np.ndarray, "cameras 3 4"],
    xyz_m: Float[np.ndarray, "frames 3"],
    ideal_px: Float[np.ndarray, "frames cameras 2"],
) -> tuple[Float[np.ndarray, "frames cameras 2 3"], Float[np.ndarray, "frames cameras 2"]]:
    """Derivative of a point's projection by its position, and residual, in each view; NaN without one, or behind it."""
    image = np.einsum("cij,fj->fci", matrices[..., :3], xyz_m) + matrices[..., 3]
    depth = np.where(image[..., 2:] > 0, image[..., 2:], np.nan)
    projected_px = image[..., :2] / depth
    turned = matrices[:, :2, :3] - projected_px[..., None] * matrices[:, 2:, :3]
    return turned / depth[..., None], ideal_px - projected_px


def _sigma_m(
    jacobian: Float[np.ndarray, "frames cameras 2 3"],
    residual_px: Float[np.ndarray, "frames cameras 2"],
    agrees: Bool[np.ndarray, "frames cameras"],
) -> Float[np.ndarray, " frames"]:
    """Standard deviation of a point: noise of all its residuals, seen by the views of each frame."""
    squares_px2 = np.where(agrees[..., None], residual_px, 0.0) ** 2
    freedoms = 2 * agrees.sum() - 3 * len(agrees)
    variance_px2 = max(float(squares_px2.sum()) / freedoms, _MIN_SIGMA_PX**2)
    rows = np.where(agrees[..., None, None], jacobian, 0.0)
    covariance_m2 = variance_px2 * np.linalg.inv(np.einsum("fcia,fcib->fab", rows, rows))
    return np.sqrt(np.trace(covariance_m2, axis1=-2, axis2=-1) / 3.0)
