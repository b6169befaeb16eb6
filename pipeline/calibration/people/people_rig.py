"""Poses of all cameras: the best pair first, then camera by camera from the people that are already located."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import cv2
import numpy as np

from pipeline.calibration.people.bodies import MatchedBodies
from pipeline.calibration.people.pairs import RelativePose
from pipeline.calibration.people.people_adjustment import adjust_poses
from pipeline.calibration.people.stature import scale_from, statures
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.geometry.undistortion import undistort_px

# Angle of the rays below which a pair is worse the smaller it is.
_GOOD_ANGLE_DEG = 25.0
_MIN_POINTS, _MIN_SHARE = 60, 0.4
# Error of a joint that still fits, pixels at a focal length of 1000.
_TOLERANCE = 0.02
_DRAWN, _TRIES, _SEED = 3000, 400, 20
# Stature while the scale is not settled: what is robust about triangulation is in metres.
_STATURE_M = 1.7


def pose_cameras(
    cameras: Sequence[Camera], relatives: Sequence[RelativePose], bodies: MatchedBodies, has_free_lenses: bool
) -> Mapping[int, Camera]:
    """Pose the cameras that can be linked, in the frame of one of them, at a scale that is about right.

    The cameras' poses are ignored. ``has_free_lenses``: focal lengths and first radial coefficients are adjusted too.
    """
    posed = _seed(cameras, relatives, bodies)
    while posed:
        numbers = sorted(posed)
        xyz_m = bodies.in_cameras(numbers).triangulated([posed[k] for k in numbers])
        waiting = [k for k in range(len(cameras)) if k not in posed]
        seen = bodies.seen() & np.isfinite(xyz_m).all(-1)[:, None]
        resected = None
        for number in sorted(waiting, key=lambda k: -int(seen[:, k].sum())):
            if (resected := _resected(cameras[number], bodies.points_px[:, number], xyz_m)) is not None:
                posed = {**posed, number: resected}
                break
        if resected is None:
            return posed
        posed = adjust_poses(posed, bodies, has_free_lenses)
    return posed


def _seed(cameras: Sequence[Camera], relatives: Sequence[RelativePose], bodies: MatchedBodies) -> dict[int, Camera]:
    """Pair with the most support at a good angle, at about the scale of people."""
    if not relatives:
        return {}
    sines = [_sine(relative.angle_deg) / _sine(_GOOD_ANGLE_DEG) for relative in relatives]
    best = max(zip(relatives, sines, strict=True), key=lambda pair: pair[0].support * min(1.0, pair[1]))[0]
    pair = [
        replace(cameras[best.first], cam_from_world=Rigid3(read_only(np.eye(3)), read_only(np.zeros(3)))),
        replace(cameras[best.second], cam_from_world=best.second_from_first),
    ]
    both = bodies.in_cameras([best.first, best.second])
    found = statures(both.triangulated(pair), bodies.group)
    if not len(found):
        return {}
    scale = scale_from(found, _STATURE_M)
    second = best.second_from_first
    pair[1] = replace(pair[1], cam_from_world=Rigid3(second.rotation, read_only(scale * second.translation_m)))
    return {best.first: pair[0], best.second: pair[1]}


def _sine(angle_deg: float) -> float:
    return float(np.sin(np.radians(min(angle_deg, 180.0 - angle_deg))))


def _resected(camera: Camera, points_px: np.ndarray, xyz_m: np.ndarray) -> Camera | None:
    """Pose of a camera from located joints (perspective-n-point with RANSAC); ``None`` if too few agree."""
    known = np.isfinite(points_px).all(-1) & np.isfinite(xyz_m).all(-1)
    if known.sum() < _MIN_POINTS:
        return None
    points, places_m = undistort_px(camera, points_px[known]), xyz_m[known]
    inverse = np.linalg.inv(camera.matrix)
    points = points @ inverse[:2, :2].T + inverse[:2, 2]
    chosen = np.random.default_rng(_SEED).permutation(len(points))[:_DRAWN]
    cv2.setRNGSeed(_SEED)
    is_found, turn, shift, inliers = cv2.solvePnPRansac(
        places_m[chosen], points[chosen], np.eye(3), None, iterationsCount=_TRIES, reprojectionError=_TOLERANCE,
        confidence=0.999, flags=cv2.SOLVEPNP_EPNP,
    )  # fmt: skip
    if not is_found or inliers is None or len(inliers) < _MIN_SHARE * len(chosen):
        return None
    rotation, _ = cv2.Rodrigues(turn)
    return replace(camera, cam_from_world=Rigid3(read_only(rotation), read_only(shift[:, 0])))
