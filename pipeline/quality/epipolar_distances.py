"""Agreement of cameras in pairs: epipolar distances of people whom both see."""

import itertools
from collections.abc import Iterable, Mapping

import numpy as np
from jaxtyping import Float

from pipeline.data.cameras import Camera
from pipeline.data.people import Observations, Track3D
from pipeline.geometry.camera import center_in_world
from pipeline.geometry.epipolar import epipolar_distance_px, fundamental_matrices
from pipeline.geometry.undistortion import undistort_views

# Frames of a track that are compared, and least number of joints of a pair.
_MAX_FRAMES, _MIN_JOINTS = 200, 100
_MIN_SCORE = 0.3
# Cameras that are closer have no epipolar lines to speak of.
_MIN_BASELINE_M = 0.1

Pairs = Mapping[tuple[int, int], float]
"""Distances by positions of two cameras."""
PersonPairs = Mapping[tuple[int, int], Float[np.ndarray, " _"]]
"""Distances of a person's joints by positions of two cameras."""


class CameraPairs:
    """Pairs of cameras of which people are compared; cameras that stand side by side are left out."""

    def __init__(self, cameras: tuple[Camera, ...]) -> None:
        self._cameras, self._centers_m = cameras, [center_in_world(camera) for camera in cameras]
        self._pairs = [
            (i, j)
            for i, j in itertools.combinations(range(len(cameras)), 2)
            if np.linalg.norm(self._centers_m[i] - self._centers_m[j]) > _MIN_BASELINE_M
        ]
        self._fundamentals = fundamental_matrices(cameras) if self._pairs else np.zeros((0, 0, 3, 3))

    def distances_m(self, located: Track3D, observed: Observations) -> PersonPairs:
        """Epipolar distances of a person's joints in each pair of cameras, in metres at the person.

        The distance in pixels (Chen et al. 2020, eq. 13) is scaled by the distance of the joint over the focal length.
        Joints and observations are without fingers.
        """
        if not self._pairs:
            return {}
        rows = slice(None, None, max(1, located.num_frames // _MAX_FRAMES))
        ideal_px, metres_per_px = self._undistorted(observed, rows), self._metres_per_px(located, rows)
        distances = {}
        for i, j in self._pairs:
            distance_px = epipolar_distance_px(self._fundamentals[i, j], ideal_px[:, i], ideal_px[:, j])
            distance_m = distance_px * (metres_per_px[:, i] + metres_per_px[:, j]) / 2
            distances[i, j] = distance_m[np.isfinite(distance_m)]
        return distances

    def _undistorted(self, observed: Observations, rows: slice) -> Float[np.ndarray, "frames cameras joints 2"]:
        points_px = np.where(observed.score[rows][..., None] >= _MIN_SCORE, observed.points_px[rows], np.nan)
        return undistort_views(self._cameras, points_px)

    def _metres_per_px(self, located: Track3D, rows: slice) -> Float[np.ndarray, "frames cameras joints"]:
        distance_m = [np.linalg.norm(located.xyz_m[rows] - center_m, axis=-1) for center_m in self._centers_m]
        return np.stack(
            [far_m / camera.matrix[0, 0] for far_m, camera in zip(distance_m, self._cameras, strict=True)], axis=1
        )


def median_distances_m(people: Iterable[PersonPairs]) -> Pairs:
    """Median epipolar distance of each pair of cameras over everybody, in metres.

    Pairs with fewer than 100 common joints are left out.
    """
    distances: dict[tuple[int, int], list[Float[np.ndarray, " _"]]] = {}
    for person in people:
        for pair, distance_m in person.items():
            distances.setdefault(pair, []).append(distance_m)
    joined = {pair: np.concatenate(parts) for pair, parts in distances.items()}
    return {pair: float(np.median(some)) for pair, some in joined.items() if len(some) >= _MIN_JOINTS}
