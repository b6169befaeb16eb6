"""Agreement of cameras in pairs: epipolar distances of people whom both see."""

import itertools
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from pipeline.data import Observations, Reconstruction, Track3D
from pipeline.geometry.camera import center_in_world
from pipeline.geometry.epipolar import epipolar_distance_px, fundamental_matrices
from pipeline.geometry.undistortion import undistort_px
from pipeline.joints import FINGER_JOINTS

# Frames of a track that are compared, and least number of joints of a pair.
_MAX_FRAMES, _MIN_JOINTS = 200, 100
_MIN_SCORE = 0.3
# Cameras that are closer have no epipolar lines to speak of.
_MIN_BASELINE_M = 0.1

Pairs = Mapping[tuple[int, int], float]
"""Distances by positions of two cameras."""


def epipolar_distances_m(reconstruction: Reconstruction) -> Pairs:
    """Median epipolar distance of each pair of cameras, in metres at the people.

    The distance in pixels (Chen et al. 2020, eq. 13) is scaled by the distance of the joint over the focal length.
    Pairs with fewer than 100 common joints are left out, and cameras that stand side by side.
    """
    cameras = reconstruction.cameras
    body = [number for number, name in enumerate(reconstruction.joints.names) if name not in FINGER_JOINTS]
    centers_m = [center_in_world(camera) for camera in cameras]
    pairs = [
        (i, j)
        for i, j in itertools.combinations(range(len(cameras)), 2)
        if np.linalg.norm(centers_m[i] - centers_m[j]) > _MIN_BASELINE_M
    ]
    if not pairs:
        return {}
    fundamentals = fundamental_matrices(cameras)
    found: dict[tuple[int, int], list[Float[np.ndarray, " _"]]] = {}
    for track, observed in zip(reconstruction.located, reconstruction.observations, strict=True):
        rows = slice(None, None, max(1, track.num_frames // _MAX_FRAMES))
        ideal_px = _undistorted(reconstruction, observed, rows, body)
        metres_per_px = _metres_per_px(reconstruction, track, rows, body)
        for i, j in pairs:
            distance_px = epipolar_distance_px(fundamentals[i, j], ideal_px[:, i], ideal_px[:, j])
            distance_m = distance_px * (metres_per_px[:, i] + metres_per_px[:, j]) / 2
            found.setdefault((i, j), []).append(distance_m[np.isfinite(distance_m)])
    joined = {pair: np.concatenate(parts) for pair, parts in found.items()}
    return {pair: float(np.median(some)) for pair, some in joined.items() if len(some) >= _MIN_JOINTS}


def _undistorted(
    reconstruction: Reconstruction, observed: Observations, rows: slice, body: list[int]
) -> Float[np.ndarray, "frames cameras joints 2"]:
    points_px = observed.points_px[rows][:, :, body]
    points_px = np.where(observed.score[rows][:, :, body, None] >= _MIN_SCORE, points_px, np.nan)
    return np.stack([undistort_px(camera, points_px[:, c]) for c, camera in enumerate(reconstruction.cameras)], axis=1)


def _metres_per_px(
    reconstruction: Reconstruction, track: Track3D, rows: slice, body: list[int]
) -> Float[np.ndarray, "frames cameras joints"]:
    xyz_m = track.xyz_m[rows][:, body]
    return np.stack(
        [
            np.linalg.norm(xyz_m - center_in_world(camera), axis=-1) / camera.matrix[0, 0]
            for camera in reconstruction.cameras
        ],
        axis=1,
    )
