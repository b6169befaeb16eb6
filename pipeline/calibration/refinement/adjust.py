"""Adjustment of cameras to sightings: robust Levenberg-Marquardt with the points eliminated.

Parameters of a camera are a rotation in its own axes (radians), the shift of its centre (metres) and the logarithm of
its focal length. The points are eliminated by the Schur complement (Triggs et al. 2000, "Bundle adjustment - a modern
synthesis", section 6.1). Weights are those of the Cauchy loss.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from pipeline.calibration.adjustment import parameters, projection
from pipeline.calibration.refinement.sightings import Sightings
from pipeline.data import Camera
from pipeline.geometry.camera import center_in_world, image_from_world, project
from pipeline.geometry.triangulation import triangulate_robust
from pipeline.geometry.undistortion import undistort_px

ROTATION, POSITION, FOCAL = parameters.ROTATION, parameters.POSITION, parameters.FOCAL
"""Parameters of a camera: the first seven of ``adjustment.parameters``."""
NUM_PARAMETERS = 7

PRIOR_SIGMA = np.array([np.radians(5.0)] * 3 + [0.3] * 3 + [0.1])
"""Standard deviations of the parameters before anything is seen: a calibration is off by degrees at most."""

# Scale of the loss over the standard deviation of the inliers (95 % efficiency for normal errors), and its least value.
_CAUCHY, _MIN_SIGMA_PX = 2.385, 0.3
_MAX_STEPS, _NUM_SCALES = 15, 3
# A step that changes no parameter by more than this share of its prior's standard deviation ends the search.
_SMALL_STEP = 2e-4
# Least information of the sightings on a parameter, in units of the prior's.
_MIN_INFORMATION = 100.0

Free = Bool[np.ndarray, "cameras 7"]


@dataclass(frozen=True, slots=True, eq=False)
class Adjustment:
    """Adjusted cameras.

    Parameters
    ----------
    cameras
        Cameras after the adjustment.
    sigma
        Standard deviations of the parameters with the world's position, orientation and scale fixed; that of
        ``PRIOR_SIGMA`` where the sightings say nothing, 0 where a parameter was not free.
    """

    cameras: tuple[Camera, ...]
    sigma: Float[np.ndarray, "cameras 7"]


def triangulate_sightings(
    cameras: Sequence[Camera], points_px: Float[np.ndarray, "points cameras 2"]
) -> Float[np.ndarray, "points 3"]:
    """Triangulate points robustly; NaN where fewer than two cameras see one, or all rays are parallel."""
    ideal_px = np.stack([undistort_px(camera, points_px[:, c]) for c, camera in enumerate(cameras)])
    matrices = np.array([image_from_world(camera) for camera in cameras])
    return triangulate_robust(matrices, ideal_px, np.isfinite(ideal_px).all(-1).astype(float))


def adjust(given: Sequence[Camera], start: Sequence[Camera], sightings: Sightings, free: Free) -> Adjustment:
    """Adjust cameras to sightings.

    Parameters
    ----------
    given
        Cameras as calibrated, means of the prior.
    start
        Cameras with which the search begins; parameters that may not change are those of ``given``.
    free
        Parameters that may change.
    """
    begin = camera_offsets(given, start) * free
    start = tuple(move_camera(camera, step) for camera, step in zip(given, begin, strict=True))
    xyz_m = triangulate_sightings(start, sightings.points_px)
    is_known = np.isfinite(xyz_m).all(-1)
    xyz_m, points_px = xyz_m[is_known], sightings.points_px[is_known]
    state = _State(start, xyz_m)
    for _ in range(_NUM_SCALES):
        sigma_px = _sigma_px(_residuals(state, points_px), len(xyz_m))
        problem = _Problem(tuple(given), points_px, free, sigma_px)
        state = _search(problem, state)
    return Adjustment(state.cameras, _sigma(state.cameras, _Normal(problem, state).reduced, free))


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    cameras: tuple[Camera, ...]
    xyz_m: Float[np.ndarray, "points 3"]


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """Fixed facts of a search: the cameras of the prior, the sightings, the free parameters and the noise."""

    given: tuple[Camera, ...]
    points_px: Float[np.ndarray, "points cameras 2"]
    free: Free
    sigma_px: float


def _residuals(
    state: _State, points_px: Float[np.ndarray, "points cameras 2"]
) -> Float[np.ndarray, "points cameras 2"]:
    """Projections minus observations; NaN where a camera sees nothing."""
    return np.stack([project(camera, state.xyz_m) for camera in state.cameras], axis=1) - points_px


def _sigma_px(residuals_px: Float[np.ndarray, "points cameras 2"], num_points: int) -> float:
    """Standard deviation of a coordinate, from the median distance (Rayleigh), for the freedom of the points."""
    distance_px = np.linalg.norm(residuals_px, axis=-1)
    distance_px = distance_px[np.isfinite(distance_px)]
    if len(distance_px) == 0:
        return _MIN_SIGMA_PX
    left = max(0.1, 1.0 - 3 * num_points / (2 * len(distance_px)))
    return max(_MIN_SIGMA_PX, float(np.median(distance_px)) / 1.177 / np.sqrt(left))


def _search(problem: _Problem, state: _State) -> _State:
    """Levenberg-Marquardt from a state."""
    damping = 1e-4
    cost = _cost(problem, state)
    for _ in range(_MAX_STEPS):
        normal = _Normal(problem, state)
        while damping < 1e6:
            step, points_step_m = normal.solve(damping)
            changed = _moved(state, step, points_step_m)
            if (new_cost := _cost(problem, changed)) < cost:
                break
            damping *= 10.0
        else:
            break
        state, cost, damping = changed, new_cost, max(1e-9, damping / 10.0)
        if np.abs(step / PRIOR_SIGMA).max() < _SMALL_STEP:
            break
    return state


def _cost(problem: _Problem, state: _State) -> float:
    """Cauchy loss of the residuals plus the prior; infinite if a point falls behind a camera that sees it."""
    residuals_px = _residuals(state, problem.points_px)
    is_seen = np.isfinite(problem.points_px).all(-1)
    squared = (residuals_px[is_seen] ** 2).sum(-1) / (_CAUCHY * problem.sigma_px) ** 2
    prior = float(((camera_offsets(problem.given, state.cameras) / PRIOR_SIGMA) ** 2).sum())
    loss = float(_CAUCHY**2 * np.log1p(squared).sum()) + prior
    return loss if np.isfinite(loss) else np.inf


def camera_offsets(given: Sequence[Camera], cameras: Sequence[Camera]) -> Float[np.ndarray, "cameras 7"]:
    """Parameters of cameras relative to the given ones: the steps by which ``move_camera`` gets to them."""
    return parameters.offsets(given, cameras)[:, :NUM_PARAMETERS]


class _Normal:
    """Normal equations of a state, with the points eliminated when they are solved."""

    def __init__(self, problem: _Problem, state: _State) -> None:
        num_points, num_cameras = problem.points_px.shape[:2]
        self._free = problem.free
        of_cameras = np.zeros((num_points, num_cameras, 2, NUM_PARAMETERS))
        of_points = np.zeros((num_points, num_cameras, 2, 3))
        residuals = np.zeros((num_points, num_cameras, 2))
        for c, camera in enumerate(state.cameras):
            projected_px, by_camera, by_point = linearise(camera, state.xyz_m)
            residual_px = (projected_px - problem.points_px[:, c]) / problem.sigma_px
            is_seen = np.isfinite(residual_px).all(-1)
            # Root of the Cauchy weight: the rows are squared.
            root = 1.0 / np.sqrt(1.0 + (residual_px**2).sum(-1) / _CAUCHY**2)
            factor = (root / problem.sigma_px)[:, None, None]
            residuals[is_seen, c] = (root[:, None] * residual_px)[is_seen]
            of_cameras[is_seen, c] = (factor * by_camera * problem.free[c])[is_seen]
            of_points[is_seen, c] = (factor * by_point)[is_seen]
        size = num_cameras * NUM_PARAMETERS
        own = np.einsum("pcia,pcib->cab", of_cameras, of_cameras)
        precision = 1.0 / PRIOR_SIGMA**2
        self._cameras = np.zeros((size, size))
        for c in range(num_cameras):
            block = slice(c * NUM_PARAMETERS, (c + 1) * NUM_PARAMETERS)
            self._cameras[block, block] = own[c] + np.diag(precision)
        offsets = camera_offsets(problem.given, state.cameras)
        self._right = (np.einsum("pcia,pci->ca", of_cameras, residuals) + problem.free * precision * offsets).ravel()
        self._mixed = np.einsum("pcia,pcij->pcaj", of_cameras, of_points).reshape(num_points, size, 3)
        self._points = np.einsum("pcij,pcik->pjk", of_points, of_points)
        self._points_right = np.einsum("pcij,pci->pj", of_points, residuals)

    @property
    def reduced(self) -> Float[np.ndarray, "parameters parameters"]:
        """Normal matrix of the cameras after the points are eliminated: the inverse of their covariance."""
        return self._reduce(0.0)[0]

    def _reduce(self, damping: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        diagonal = np.arange(3)
        points = self._points.copy()
        points[:, diagonal, diagonal] *= 1.0 + damping
        points[:, diagonal, diagonal] += 1e-6  # a point that is hardly seen stays where it is
        inverse = np.linalg.inv(points)
        eliminated = self._mixed @ inverse
        size = len(self._right)
        cameras = (
            self._cameras - eliminated.swapaxes(0, 1).reshape(size, -1) @ self._mixed.swapaxes(0, 1).reshape(size, -1).T
        )
        right = self._right - np.einsum("paj,pj->a", eliminated, self._points_right)
        return cameras, right, inverse

    def solve(self, damping: float) -> tuple[np.ndarray, np.ndarray]:
        """Steps of the cameras and of the points."""
        cameras, right, inverse = self._reduce(damping)
        cameras = cameras + damping * np.diag(np.diag(cameras))
        step = np.where(self._free.ravel(), -np.linalg.solve(cameras, right), 0.0)
        of_points = self._points_right + np.einsum("paj,a->pj", self._mixed, step)
        return step.reshape(-1, NUM_PARAMETERS), -(inverse @ of_points[..., None])[..., 0]


def _moved(state: _State, step: Float[np.ndarray, "cameras 7"], points_step_m: Float[np.ndarray, "points 3"]) -> _State:
    cameras = tuple(move_camera(camera, of_camera) for camera, of_camera in zip(state.cameras, step, strict=True))
    return _State(cameras, state.xyz_m + points_step_m)


def move_camera(camera: Camera, step: Float[np.ndarray, " 7"]) -> Camera:
    """Turn a camera in its own axes (radians), shift its centre (metres), and scale its focal length (logarithm)."""
    return parameters.move_camera(camera, np.pad(step, (0, parameters.NUM_PARAMETERS - NUM_PARAMETERS)))


def linearise(
    camera: Camera, xyz_m: Float[np.ndarray, "points 3"]
) -> tuple[Float[np.ndarray, "points 2"], Float[np.ndarray, "points 2 7"], Float[np.ndarray, "points 2 3"]]:
    """Distorted projections and their derivatives by the camera's parameters and by the points."""
    points_px, by_camera, by_point = projection.linearise(camera, xyz_m)
    return points_px, by_camera[..., :NUM_PARAMETERS], by_point


def _sigma(
    cameras: Sequence[Camera], reduced: Float[np.ndarray, "parameters parameters"], free: Free
) -> Float[np.ndarray, "cameras 7"]:
    """Standard deviations of the free parameters.

    If all poses are free, the world may move, turn and grow: these seven directions (inner constraints) are left out.
    """
    kept = np.flatnonzero(free.ravel())
    scaled = np.diag(np.tile(PRIOR_SIGMA, len(cameras))[kept])
    normal = scaled @ reduced[np.ix_(kept, kept)] @ scaled
    basis = np.eye(len(kept))
    if free[:, : FOCAL.start].all():
        # Cameras that see hardly anything do not fix the world.
        information = (np.diag(reduced).reshape(free.shape) * PRIOR_SIGMA**2)[:, : FOCAL.start]
        is_fixed = information.min(-1) > _MIN_INFORMATION
        moves = np.linalg.solve(scaled, (_world_moves(cameras) * is_fixed[:, None, None]).reshape(-1, 7)[kept])
        left, values, _ = np.linalg.svd(moves)
        basis = left[:, int((values > 1e-9 * values.max(initial=1e-9)).sum()) :]
    covariance = scaled @ basis @ np.linalg.inv(basis.T @ normal @ basis) @ basis.T @ scaled
    sigma = np.zeros(free.size)
    sigma[kept] = np.sqrt(np.diag(covariance))
    return sigma.reshape(free.shape)


def _world_moves(cameras: Sequence[Camera]) -> Float[np.ndarray, "cameras 7 7"]:
    """Derivatives of the cameras' parameters by a shift, a turn and a growth of the world."""
    centers_m = np.array([center_in_world(camera) for camera in cameras])
    arms_m = centers_m - centers_m.mean(0)
    moves = np.zeros((len(cameras), NUM_PARAMETERS, 7))
    moves[:, POSITION, 0:3] = np.eye(3)
    for axis in range(3):
        moves[:, POSITION, 3 + axis] = np.cross(np.eye(3)[axis], arms_m)
        moves[:, ROTATION, 3 + axis] = [-camera.cam_from_world.rotation[:, axis] for camera in cameras]
    moves[:, POSITION, 6] = arms_m
    return moves
