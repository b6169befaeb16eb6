"""Noisy observations of joints in known positions, and the track that triangulation makes of them."""

import numpy as np

from pipeline.core.data.cameras import Camera
from pipeline.core.data.people import Observations, Source, Track3D
from pipeline.geometry.camera import image_from_world, project
from pipeline.geometry.tracks import reproject
from pipeline.geometry.triangulation import triangulate
from pipeline.geometry.undistortion import undistort_px
from tests.pipeline.conftest import ring_camera


def ring_of(num_cameras: int) -> tuple[Camera, ...]:
    """Cameras on a circle of four metres, evenly spaced."""
    angles_rad = np.linspace(0.0, 2 * np.pi, num_cameras, endpoint=False) + 0.2
    return tuple(ring_camera(f"cam{k}", angle_rad) for k, angle_rad in enumerate(angles_rad))


def observe(
    cameras: tuple[Camera, ...],
    xyz_m: np.ndarray,
    noise_px: float = 0.0,
    unseen: np.ndarray | None = None,
    seed: int = 0,
) -> tuple[Track3D, Observations]:
    """Observe joints with a score of 0.9 in all cameras, and triangulate them.

    Parameters
    ----------
    xyz_m
        True positions (frames, joints, 3), NaN where a joint is invisible.
    unseen
        Views that see nothing, (frames, cameras, joints).
    """
    points_px = np.stack([project(camera, xyz_m) for camera in cameras], axis=1)
    points_px += np.random.default_rng(seed).normal(0.0, noise_px, points_px.shape)
    if unseen is not None:
        points_px[unseen] = np.nan
    score = np.where(np.isfinite(points_px[..., 0]), 0.9, 0.0)
    straight_px = np.stack([undistort_px(camera, points_px[:, k]) for k, camera in enumerate(cameras)], axis=1)
    located_m = triangulate(np.stack([image_from_world(camera) for camera in cameras]), straight_px, score)
    error_px, mean_score, views = reproject(cameras, located_m, points_px, score)
    present = np.isfinite(located_m).all(-1)
    source = np.where(present, Source.MEASURED, Source.ABSENT).astype(np.int8)
    return Track3D(1, 0, located_m, mean_score, source, error_px, views), Observations(1, points_px, score)
