"""Cameras that see people shifted against the other cameras, measured in each camera's own detector noise.

A camera is judged by points that are triangulated without it. Its shift is the part of its residuals that a turn and a
zoom of the camera explain, as a moved camera or a wrong lens leaves them. Noise, hidden joints and bodies of other
people have no common direction, in crowds as in small pictures: they make the shift uncertain, not large. The camera
whose shift explains most of all residuals is corrected first, then the others are judged again.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import fdtrc

from pipeline.calibration.adjustment import parameters
from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import projection_matrices
from pipeline.geometry.triangulation import triangulate
from pipeline.geometry.undistortion import undistort_views

# Parameters of a shift. A turn and a zoom need no unit of the world, and explain most of a change of position, too.
_PARAMETERS = np.r_[parameters.ROTATION, parameters.FOCAL]
# Degrees of freedom of Student's t, the distribution of residuals: a detector errs by much now and then.
_TAIL = 4.0
_POINT_STEPS, _SHIFT_STEPS = 5, 10
# Smallest error of a camera, as a share of the median error of all cameras: points would follow it alone.
_LEAST_ERROR = 0.5
# Median length of a normal vector in the plane, in standard deviations of a coordinate.
_MEDIAN_LENGTH = 1.177
# Determinant of a normal matrix over its cubed trace, below which two other cameras do not determine a point.
_MIN_DETERMINANT = 1e-5
# Cameras of which the correction is tried.
_MAX_SUSPECTS = 3
# Fewer bodies do not determine a shift and its error.
_MIN_BODIES = 8
_MAX_CHANCE = 1e-6
"""Probability of a shift by chance, below which the shift is certain."""
_MIN_SHIFT, _BIAS = 0.4, 1.0
"""Smallest shift that counts, and usual shift of a single person, in standard deviations of a joint's coordinate.

Detectors err alike on one person at all instants, by the clothes and the side that a camera sees: the shift of a right
camera before two to four people is 0.1 to 0.44 of a deviation. Of several people these errors cancel like noise.
"""


# Smallest shift that matters, as a share of a person's size: 8 mm of a grown person.
_MIN_SHARE = 0.005


@dataclass(frozen=True, slots=True, eq=False)
class CameraShift:
    """Shift of a camera against the others."""

    camera: int  # Position of the camera
    step: Float[np.ndarray, " 22"]  # Step of ``move_camera`` that takes the shift away
    shift_px: float  # Median length of the shift at the people
    noise_px: float  # Standard deviation of a coordinate of what is left without the shift
    share: float  # Median length of the shift as a share of the extent of a person in the picture
    num_bodies: int  # Number of bodies that were compared
    num_people: float  # Mean number of people at an instant
    chance: float  # Probability of such a shift by chance
    gain: float  # Increase of the log-likelihood by the step

    @property
    def is_certain(self) -> bool:
        """True if the shift is neither chance nor a habit of the detector."""
        least = max(_MIN_SHIFT, _BIAS / np.sqrt(self.num_people))
        is_large = self.shift_px > least * self.noise_px and self.share > _MIN_SHARE
        return bool(is_large and self.chance < _MAX_CHANCE)

    @property
    def message(self) -> str:
        """Sentence about the camera."""
        return (
            f"The camera sees people {self.shift_px:.1f} pixels elsewhere than the other cameras do, "
            f"{100 * self.share:.1f} % of a person's size. Its detections err by {self.noise_px:.1f} pixels."
        )

    @property
    def evidence(self) -> Mapping[str, float]:
        """Measured numbers of a finding."""
        numbers = {"shift_px": self.shift_px, "noise_px": self.noise_px, "share": self.share}
        return {name: round(value, 3) for name, value in numbers.items()} | {"num_bodies": self.num_bodies}


def find_shifted(
    cameras: Sequence[Camera],
    points_px: Float[np.ndarray, "bodies cameras joints 2"],
    instant: Int[np.ndarray, " bodies"],
) -> list[CameraShift]:
    """Find the cameras that are shifted for certain, the worst one first; at most half of the cameras.

    ``points_px``: joints of people in the pictures, NaN where a camera does not see a joint. Joints that fewer than
    three cameras see are not used. ``instant``: instant of each person. At different instants the errors of the
    detector differ: a quarter of a second.
    """
    corrected = list(cameras)
    shifted: list[CameraShift] = []
    while 2 * (len(shifted) + 1) <= len(cameras):
        known = {shift.camera for shift in shifted}
        shifts = measure_shifts(corrected, points_px, instant)
        certain = [shift for shift in shifts if shift.is_certain and shift.camera not in known]
        if not certain:
            break
        # Of cameras that explain nearly as much the wrong one is the camera whose correction leaves least to explain.
        suspects = sorted(certain, key=lambda shift: -shift.gain)[:_MAX_SUSPECTS]
        rigs = {shift.camera: _corrected(corrected, shift) for shift in suspects}
        worst = suspects[0]
        if len(suspects) > 1:
            worst = min(suspects, key=lambda shift: _total_gain(measure_shifts(rigs[shift.camera], points_px, instant)))
        shifted.append(worst)
        corrected = rigs[worst.camera]
    return shifted


def _corrected(cameras: Sequence[Camera], shift: CameraShift) -> list[Camera]:
    return [
        parameters.move_camera(camera, shift.step) if k == shift.camera else camera for k, camera in enumerate(cameras)
    ]


def _total_gain(shifts: Sequence[CameraShift]) -> float:
    return sum(shift.gain for shift in shifts)


def measure_shifts(
    cameras: Sequence[Camera],
    points_px: Float[np.ndarray, "bodies cameras joints 2"],
    instant: Int[np.ndarray, " bodies"],
) -> list[CameraShift]:
    """Measure the shift of each camera that sees enough people; for the arguments see ``find_shifted``."""
    num_cameras, num_joints = points_px.shape[1:3]
    seen_px = points_px.swapaxes(1, 2).reshape(-1, num_cameras, 2)
    body = np.repeat(np.arange(len(points_px)), num_joints)
    is_common = np.isfinite(seen_px[..., 0]).sum(-1) >= 3
    body, seen_px = body[is_common], seen_px[is_common]
    if not len(body):
        return []
    ideal_px = undistort_views(cameras, seen_px)
    weights = np.isfinite(ideal_px).all(-1)[..., None].astype(np.float64)
    xyz_m = triangulate(projection_matrices(cameras), ideal_px[:, :, None], weights)[:, 0]
    for _ in range(_POINT_STEPS):
        views = _views(cameras, xyz_m, seen_px)
        xyz_m = xyz_m + _newton_step(views.all_normal, views.all_gradient)
    views = _views(cameras, xyz_m, seen_px)
    with np.errstate(invalid="ignore"):
        low, high = (reduce(points_px, axis=2) for reduce in (np.fmin.reduce, np.fmax.reduce))
        extent_px = np.maximum(np.linalg.norm(high - low, axis=-1), 1.0)[body]
    shifts = (
        _measured_shift(number, camera, views, xyz_m, seen_px[:, number], extent_px[:, number], body, instant)
        for number, camera in enumerate(cameras)
    )
    return [shift for shift in shifts if shift is not None]


@dataclass(frozen=True, slots=True, eq=False)
class _Views:
    """Views of points, linearised, and their robust normal equations; zeros for views that are not used."""

    used: Bool[np.ndarray, "points cameras"]
    sigma_px: Float[np.ndarray, "points cameras"]  # Standard deviation of a coordinate
    by_point: Float[np.ndarray, "points cameras 2 3"]
    normal: Float[np.ndarray, "points cameras 3 3"]
    gradient: Float[np.ndarray, "points cameras 3"]
    # Number and sums of each point's used views
    num_used: Int[np.ndarray, " points"]
    all_normal: Float[np.ndarray, "points 3 3"]
    all_gradient: Float[np.ndarray, "points 3"]


def _views(
    cameras: Sequence[Camera], xyz_m: Float[np.ndarray, "points 3"], seen_px: Float[np.ndarray, "points cameras 2"]
) -> _Views:
    shape = seen_px.shape[:2]
    residual_px, by_point = np.zeros((*shape, 2)), np.zeros((*shape, 2, 3))
    used = np.zeros(shape, bool)
    px_per_m, error_m = np.ones(shape), np.full(shape[1], np.nan)
    for number, camera in enumerate(cameras):
        rows = np.flatnonzero(np.isfinite(seen_px[:, number]).all(-1))
        projected_px, by_xyz = parameters.linearise_points(camera, xyz_m[rows])
        left_px = seen_px[rows, number] - projected_px
        is_known = np.isfinite(left_px).all(-1)
        rows, left_px = rows[is_known], left_px[is_known]
        if not len(rows):
            continue
        used[rows, number] = True
        residual_px[rows, number], by_point[rows, number] = left_px, by_xyz[is_known]
        px_per_m[rows, number] = np.linalg.norm(by_point[rows, number], axis=(-2, -1))
        error_m[number] = np.median(np.linalg.norm(left_px, axis=-1) / px_per_m[rows, number])
    # The errors of a detector grow with the person in the picture. A camera that has its points to itself is no better
    # than the others by much.
    least_m = max(_LEAST_ERROR * float(np.nanmedian(error_m)), 1e-9) if used.any() else 1.0
    sigma_px = np.fmax(error_m, least_m) / _MEDIAN_LENGTH * px_per_m
    squared = (residual_px**2).sum(-1) / sigma_px**2
    weight = np.where(used, (_TAIL + 2.0) / (_TAIL + squared) / sigma_px**2, 0.0)
    weighted = by_point * weight[..., None, None]
    normal = weighted.swapaxes(-1, -2) @ by_point
    gradient = (weighted * residual_px[..., None]).sum(-2)
    return _Views(used, sigma_px, by_point, normal, gradient, used.sum(1), normal.sum(1), gradient.sum(1))


def _is_regular(normal: Float[np.ndarray, "*batch 3 3"], least: float) -> Bool[np.ndarray, "*batch"]:
    trace = np.trace(normal, axis1=-2, axis2=-1)
    return np.asarray((trace > 0.0) & (np.linalg.det(normal) > least * trace**3))


def _newton_step(
    normal: Float[np.ndarray, "points 3 3"], gradient: Float[np.ndarray, "points 3"]
) -> Float[np.ndarray, "points 3"]:
    """Step of each point; 0 where its views do not determine the point."""
    is_regular = _is_regular(normal, 1e-9)[:, None]
    safe = np.where(is_regular[..., None], normal, np.eye(3))
    return np.where(is_regular, np.linalg.solve(safe, gradient[..., None])[..., 0], 0.0)


def _measured_shift(
    number: int,
    camera: Camera,
    views: _Views,
    xyz_m: Float[np.ndarray, "points 3"],
    seen_px: Float[np.ndarray, "points 2"],
    extent_px: Float[np.ndarray, " points"],
    body: Int[np.ndarray, " points"],
    instant: Int[np.ndarray, " bodies"],
) -> CameraShift | None:
    """Fit the shift of a camera to its residuals; ``None`` if it sees too few people together with two others."""
    rows = np.flatnonzero(views.used[:, number] & (views.num_used >= 3))
    others = views.all_normal[rows] - views.normal[rows, number]
    is_regular = _is_regular(others, _MIN_DETERMINANT)
    rows, covariance = rows[is_regular], np.linalg.inv(others[is_regular])
    # Without this camera the point is a Newton step away.
    gradient = views.all_gradient[rows] - views.gradient[rows, number]
    projected = parameters.linearise(camera, xyz_m[rows] + (covariance @ gradient[..., None])[..., 0])
    residual_px, by_shift = seen_px[rows] - projected.points_px, projected.by_camera[..., _PARAMETERS]
    is_known = np.isfinite(residual_px).all(-1)
    rows, covariance = rows[is_known], covariance[is_known]
    residual_px, by_shift = residual_px[is_known], by_shift[is_known]
    bodies, of_body = np.unique(body[rows], return_inverse=True)
    if len(bodies) < _MIN_BODIES:
        return None
    by_point = views.by_point[rows, number]
    spread_px2 = by_point @ covariance @ by_point.swapaxes(-1, -2)
    sigma_px = views.sigma_px[rows, number]
    least_px = _LEAST_ERROR * sigma_px
    step = np.zeros(len(_PARAMETERS))
    for _ in range(_SHIFT_STEPS):
        # Inverses by Cramer's rule, much faster than NumPy's of small matrices.
        (a, b), (_, c) = (spread_px2 + (sigma_px**2)[:, None, None] * np.eye(2)).transpose(1, 2, 0)
        precision = np.moveaxis(np.array([[c, -b], [-b, a]]) / (a * c - b * b), -1, 0)
        left_px = residual_px - by_shift @ step
        squared = _squared(left_px, precision)
        weighted = precision @ by_shift * ((_TAIL + 2.0) / (_TAIL + squared))[:, None, None]
        scores = (weighted * left_px[..., None]).sum(1)
        # One product of all rows: NumPy computes a stack of small products one by one.
        information = weighted.reshape(-1, len(step)).T @ by_shift.reshape(-1, len(step))
        step = step + np.linalg.solve(information, scores.sum(0))
        # Residuals that are smaller than the errors of the points tell nothing about the camera.
        sigma_px = np.maximum(sigma_px * np.sqrt(np.median(squared)) / _MEDIAN_LENGTH, least_px)
    # The errors of a body's joints have causes in common: bodies are independent, not joints.
    of_bodies = np.zeros((len(bodies), len(step)))
    np.add.at(of_bodies, of_body, scores)
    wald = float(step @ information @ np.linalg.pinv(of_bodies.T @ of_bodies) @ information @ step)
    freedom = len(bodies) - len(step)
    left_px = residual_px - by_shift @ step
    before, after = _squared(residual_px, precision), _squared(left_px, precision)
    shift_px = np.linalg.norm(by_shift @ step, axis=-1)
    whole = np.zeros(parameters.NUM_PARAMETERS)
    whole[_PARAMETERS] = step
    return CameraShift(
        number,
        whole,
        float(np.median(shift_px)),
        float(np.median(np.linalg.norm(left_px, axis=-1))) / _MEDIAN_LENGTH,
        float(np.median(shift_px / extent_px[rows])),
        len(bodies),
        len(bodies) / len(np.unique(instant[bodies])),
        float(fdtrc(len(step), freedom, max(wald, 0.0) * freedom / (len(step) * len(bodies)))),
        float((_TAIL + 2.0) / 2.0 * np.log((_TAIL + before) / (_TAIL + after)).sum()),
    )


def _squared(
    residual_px: Float[np.ndarray, "points 2"], precision: Float[np.ndarray, "points 2 2"]
) -> Float[np.ndarray, " points"]:
    """Squared Mahalanobis lengths."""
    return np.einsum("ni,nij,nj->n", residual_px, precision, residual_px)
