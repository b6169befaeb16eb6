"""Pose of a camera by known points that are marked in its picture.

A start is the best of many sets of four points (random sample consensus), each solved by SQPnP and by both solutions of
a plane. Points that agree adjust the pose by their reprojection error. Of a lens that is not known, focal lengths are
tried; then focal length and first radial coefficient are adjusted under a prior.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import cv2
import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.geometry.camera import bend, project
from pipeline.geometry.undistortion import undistort_px

# Distance from the projection beyond which a point is an error, as a share of the picture's longer side: of a lens that
# is known, and of one that is not.
_WRONG = {True: 0.0075, False: 0.015}
# Fewest points that agree on a pose: they and the pose are then no accident.
_AGREEING = {True: 4, False: 5}
_MAX_SETS, _SET, _FEW = {True: 150, False: 60}, 4, 12
# Focal lengths that are tried, in longer sides of the picture: fields of view from 125 to 14 degrees.
_FOCALS = np.geomspace(0.26, 4.0, 16)
_FOCAL_SIGMA, _K1_SIGMA = 0.5, 0.1
# Standard deviation of a mark, and the residual of a point behind the camera.
_MARK_PX, _BEHIND_PX = 1.0, 1e4
_RIVAL_RAD, _MAX_STARTS = 0.1, 4
_ON_A_LINE, _FLAT = 1e-3, 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Marks:
    """Points that a camera sees, and the distorted pixels at which they are marked."""

    names: Sequence[str]
    xyz_m: Float[np.ndarray, "points 3"]
    seen_px: Float[np.ndarray, "points 2"]


@dataclass(frozen=True, slots=True, eq=False)
class PoseFit:
    """Camera that is placed by its points."""

    camera: Camera
    limit_px: float  # Error beyond which a point is wrong
    error_px: Float[np.ndarray, " points"]
    fits: Bool[np.ndarray, " points"]  # Points that agree, from which the pose is
    # Standard deviations; 0 for a known focal length
    place_sigma_m: float = 0.0
    turn_sigma_deg: float = 0.0
    focal_sigma_percent: float = 0.0
    rival_px: float = np.inf  # Root mean square error of another pose; infinite if there is none
    is_mirrored: bool = False  # The points fit, but only when they are mirrored

    @property
    def rms_px(self) -> float:
        """Root mean square error of the points that agree."""
        return float(np.sqrt(np.mean(self.error_px[self.fits] ** 2)))

    @property
    def is_agreed(self) -> bool:
        """True if so many points agree that the others are errors."""
        return bool(2 * self.fits.sum() > len(self.fits))

    @property
    def is_wrong(self) -> Bool[np.ndarray, " points"]:
        """Points that are errors."""
        return self.error_px > self.limit_px


def locate(camera: Camera, marks: Marks, has_intrinsics: bool) -> PoseFit:
    """Fit the pose of a camera to all points, or to the largest number that agrees; to none of mirrored points.

    Without ``has_intrinsics``, focal length and first radial coefficient are fitted too.
    """
    fit = locate_by_all(camera, marks, has_intrinsics)
    if fit is not None and not fit.is_wrong.any():
        return fit
    limit_px, num_points = _limit_px(camera, has_intrinsics), len(marks.names)
    nothing = PoseFit(camera, limit_px, np.full(num_points, _BEHIND_PX), np.zeros(num_points, bool))
    mirrored = locate_by_all(camera, replace(marks, xyz_m=marks.xyz_m * np.array([-1.0, 1.0, 1.0])), has_intrinsics)
    # Some mirrored points always fit: two sides of a symmetric thing.
    if mirrored is not None and not mirrored.is_wrong.any():
        return replace(nothing, is_mirrored=True)
    starts = _starts(_lenses(camera, has_intrinsics), marks, _sets(num_points, _MAX_SETS[has_intrinsics]), limit_px)
    return _best([_agreed(start, marks, has_intrinsics) for start in starts[:_MAX_STARTS]]) or nothing


def locate_by_all(camera: Camera, marks: Marks, has_intrinsics: bool) -> PoseFit | None:
    """Fit the pose of a camera to all points; ``None`` if they have no pose."""
    everything = np.arange(len(marks.names))
    starts = _starts(_lenses(camera, has_intrinsics), marks, [everything], _BEHIND_PX)
    return _best([_adjust(start, marks, everything >= 0, has_intrinsics) for start in starts[:_MAX_STARTS]])


def _limit_px(camera: Camera, has_intrinsics: bool) -> float:
    return _WRONG[has_intrinsics] * max(camera.size_px)


def _lenses(camera: Camera, has_intrinsics: bool) -> list[Camera]:
    return [camera] if has_intrinsics else [_with_focal(camera, share * max(camera.size_px)) for share in _FOCALS]


def _errors_px(camera: Camera, marks: Marks) -> Float[np.ndarray, " points"]:
    projected_px = np.nan_to_num(project(camera, marks.xyz_m), nan=_BEHIND_PX)
    return np.asarray(np.linalg.norm(projected_px - marks.seen_px, axis=-1))


def _with_focal(camera: Camera, focal_px: float) -> Camera:
    matrix = camera.matrix.copy()
    matrix[[0, 1], [0, 1]] = focal_px
    return replace(camera, matrix=read_only(matrix))


def _sets(num_points: int, most: int) -> list[np.ndarray]:
    """Sets of four points: all, or as many at random."""
    rng = np.random.default_rng(0)
    if num_points > _FEW:
        return [rng.choice(num_points, _SET, replace=False) for _ in range(most)]
    every = list(map(np.array, combinations(range(num_points), _SET)))
    return [every[k] for k in rng.permutation(len(every))[:most]]


def _starts(lenses: Sequence[Camera], marks: Marks, sets: Sequence[np.ndarray], limit_px: float) -> list[Camera]:
    """Cameras by sets of points, the one first that is nearest to the points; errors count up to the limit."""
    found: list[tuple[float, Camera]] = []
    for lens in lenses:
        ideal = (undistort_px(lens, marks.seen_px) - lens.matrix[:2, 2]) @ np.linalg.inv(lens.matrix[:2, :2]).T
        poses = [pose for chosen in sets for pose in _poses(marks.xyz_m[chosen], ideal[chosen])]
        if not poses:
            continue
        rotation, translation_m = (np.array(parts) for parts in zip(*poses, strict=True))
        in_cam = marks.xyz_m @ rotation.swapaxes(-1, -2) + translation_m[:, None]
        depth_m = np.where(in_cam[..., 2:] > 0, in_cam[..., 2:], np.nan)
        projected_px = bend(lens, in_cam[..., :2] / depth_m) @ lens.matrix[:2, :2].T + lens.matrix[:2, 2]
        error_px = np.linalg.norm(np.nan_to_num(projected_px, nan=_BEHIND_PX) - marks.seen_px, axis=-1)
        costs = (np.minimum(error_px, limit_px) ** 2).sum(-1)
        for k in np.argsort(costs)[:_MAX_STARTS]:
            pose = Rigid3(read_only(rotation[k]), read_only(translation_m[k]))
            found.append((float(costs[k]), replace(lens, cam_from_world=pose)))
    return [camera for _, camera in sorted(found, key=lambda each: each[0])]


def _poses(
    xyz_m: Float[np.ndarray, "points 3"], ideal: Float[np.ndarray, "points 2"]
) -> Iterator[tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"]]]:
    """Rotations and translations of a camera of focal length 1 that sees points, such as both solutions of a plane."""
    middle_m = xyz_m.mean(0)
    _, extent_m, axes = np.linalg.svd(xyz_m - middle_m)
    if extent_m[1] <= _ON_A_LINE * extent_m[0] or not np.isfinite(ideal).all():
        return
    # SQPnP refuses points whose coordinates are very small.
    scale_m = extent_m[0]
    local = (xyz_m - middle_m) / scale_m
    ways = [(local, cv2.SOLVEPNP_SQPNP)]
    if extent_m[2] < _FLAT * extent_m[0]:
        ways.append((local @ axes[:2].T @ axes[:2], cv2.SOLVEPNP_IPPE))
    for points, way in ways:
        try:
            _, turns, shifts, _ = cv2.solvePnPGeneric(points, ideal, np.eye(3), None, flags=way)
        except cv2.error:  # marks at one place
            continue
        for turn, shift_m in zip(turns, shifts, strict=True):
            rotation = Rotation.from_rotvec(turn.ravel()).as_matrix()
            if np.isfinite(rotation).all() and np.isfinite(shift_m).all():
                yield rotation, scale_m * shift_m.ravel() - rotation @ middle_m


def _best(fits: Sequence[PoseFit | None]) -> PoseFit | None:
    """Fit with the most points, then the least error."""
    found = sorted((fit for fit in fits if fit is not None), key=lambda fit: (-fit.fits.sum(), fit.rms_px))
    if not found:
        return None
    turns = [Rotation.from_matrix(fit.camera.cam_from_world.rotation) for fit in found]
    rivals = [
        fit.rms_px for fit, turn in zip(found, turns, strict=True) if (turn * turns[0].inv()).magnitude() > _RIVAL_RAD
    ]
    return replace(found[0], rival_px=min(rivals, default=np.inf))


def _agreed(start: Camera, marks: Marks, has_intrinsics: bool) -> PoseFit | None:
    """Adjust a start to the points with which it agrees."""
    fit, agrees = None, _errors_px(start, marks) <= _limit_px(start, has_intrinsics)
    for _ in range(3):
        if agrees.sum() < _AGREEING[has_intrinsics]:
            break
        fit = _adjust(start, marks, agrees, has_intrinsics)
        start, agrees = fit.camera, ~fit.is_wrong
    return fit


def _adjust(start: Camera, marks: Marks, fits: Bool[np.ndarray, " points"], has_intrinsics: bool) -> PoseFit:
    """Camera with the least reprojection error of some points, and the deviations that their marks leave."""
    pose, xyz_m, seen_px = start.cam_from_world, marks.xyz_m[fits], marks.seen_px[fits]
    middle_m = xyz_m.mean(0)

    def stepped(step: Float[np.ndarray, " unknowns"]) -> Camera:
        # Turns about the points' middle: the marks determine turn and distance apart from each other.
        rotation = Rotation.from_rotvec(step[:3]).as_matrix() @ pose.rotation
        moved = Rigid3(read_only(rotation), read_only(pose.apply(middle_m) + step[3:6] - rotation @ middle_m))
        if has_intrinsics:
            return replace(start, cam_from_world=moved)
        lens = _with_focal(start, start.matrix[0, 0] * np.exp(step[6]))
        return replace(lens, cam_from_world=moved, distortion=read_only(np.array([step[7], 0.0, 0.0, 0.0])))

    def residuals(step: Float[np.ndarray, " unknowns"]) -> Float[np.ndarray, " residuals"]:
        camera = stepped(step)
        off_px = (np.nan_to_num(project(camera, xyz_m), nan=_BEHIND_PX) - seen_px).ravel()
        if has_intrinsics:
            return off_px / _MARK_PX
        off_guess = np.log(camera.matrix[0, 0] / max(camera.size_px)) / _FOCAL_SIGMA
        return np.concatenate([off_px / _MARK_PX, [off_guess, step[7] / _K1_SIGMA]])

    found = least_squares(residuals, np.zeros(6 if has_intrinsics else 8), x_scale="jac", method="lm", max_nfev=2000)
    camera = stepped(found.x)
    growth = max(1.0, 2 * found.cost / (len(found.fun) - len(found.x)))
    inverse = np.linalg.pinv(found.jac)
    covariance = growth * inverse @ inverse.T
    # A turn of the world about the points' middle moves the camera.
    arm_m = camera.cam_from_world.apply(middle_m)
    place_from_step = np.hstack([np.cross(np.eye(3), arm_m).T, -np.eye(3)])
    return PoseFit(
        camera,
        _limit_px(camera, has_intrinsics),
        _errors_px(camera, marks),
        fits,
        float(np.sqrt(np.trace(place_from_step @ covariance[:6, :6] @ place_from_step.T))),
        float(np.degrees(np.sqrt(np.trace(covariance[:3, :3])))),
        0.0 if has_intrinsics else float(100 * np.sqrt(covariance[6, 6])),
    )
