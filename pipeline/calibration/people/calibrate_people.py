"""Calibration from people: the whole way."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import cv2
import numpy as np

from pipeline.calibration.known_points.fit import place_by_points
from pipeline.calibration.known_points.point_checks import point_problems
from pipeline.calibration.people import people_checks
from pipeline.calibration.people.bodies import MatchedBodies, gather_bodies
from pipeline.calibration.people.pairs import RelativePose, relate_by_people
from pipeline.calibration.people.people_adjustment import PeopleFit, adjust_people_rig, adjust_poses
from pipeline.calibration.people.people_world import PeopleWorld, find_people_world
from pipeline.calibration.people.stature import scale_from, statures
from pipeline.calibration.people.tracklets import ViewTracklet, find_tracklets, shared_instants, with_camera
from pipeline.calibration.report import CalibrationResult, report_camera
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, FrameTimes
from pipeline.core.data.detections import Detections
from pipeline.core.data.rigid import Rigid3
from pipeline.core.errors import InputError
from pipeline.core.joints import JointSet
from pipeline.core.options.job_choices import KnownPoint
from pipeline.core.progress import OnShare, ignore
from pipeline.geometry.undistortion import undistort_px

# Focal lengths that are tried where they are not known, over the guessed one: fields of view from 80 to 28 degrees.
_FOCAL_FACTORS = (0.6, 0.75, 1.0, 1.4, 2.0)
# Pairs of cameras with which they are tried.
_PAIRS_TRIED = 6


def calibrate_people(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    detections: Mapping[str, Detections],
    joints: JointSet,
    stature_m: Sequence[float],
    has_intrinsics: bool,
    on_share: OnShare = ignore,
    known_points: Sequence[KnownPoint] = (),
) -> CalibrationResult:
    """Calibrate cameras from people who walk about.

    Tracklets of each camera are matched without geometry, by the essential matrix to which most of them fit. The pairs
    link the cameras, perspective-n-point and bundle adjustment place them. Stature gives the scale, upright standing
    the vertical, feet the floor.

    Parameters
    ----------
    cameras
        Cameras with known or guessed intrinsics; their poses are ignored.
    times, detections
        Frame times in seconds and bodies in distorted pixels (NaN with score 0 where a joint was not detected), by
        name of the camera.
    joints
        Joints of the detections.
    stature_m
        Statures of the people, in any order; one for all is enough. Several go to people by their heights.
    has_intrinsics
        Whether the intrinsics are known, and stay; else a focal length and a radial coefficient of each camera are
        estimated.
    known_points
        Points that determine the world with its scale, in place of the people.

    Returns
    -------
    CalibrationResult
        Cameras, world in metres with Z up, and what is doubtful.

    Raises
    ------
    InputError
        If too few people are seen, if cameras can't be linked, or if they or the known points disagree.

    Examples
    --------
    A minute of people is enough; a second of them is refused:

    >>> from dataclasses import replace
    >>> from pipeline.validation.simulation.scenes import SCENES, record
    >>> take = record(replace(SCENES["room"], duration_s=1.0), seed=0, num_views=3)
    >>> try:
    ...     calibrate_people(take.cameras, take.times, take.detections, take.joints, (1.75,), has_intrinsics=True)
    ... except InputError as error:
    ...     print(error.problems[0].code)
    people_not_found
    """
    if known_points and (problems := point_problems(known_points, {camera.name: camera.size_px for camera in cameras})):
        raise InputError(problems)
    instants_s = shared_instants([times[camera.name] for camera in cameras])
    tracklets = find_tracklets(cameras, times, detections, joints, instants_s)
    rate_hz = 1.0 / float(instants_s[1] - instants_s[0])
    people_checks.require_people(cameras, tracklets, rate_hz)
    on_share(0.1)
    if not has_intrinsics:
        cameras = _with_likely_focals(cameras, tracklets)
        tracklets = [with_camera(tracklet, cameras[tracklet.camera]) for tracklet in tracklets]
    on_share(0.3)
    relatives = _relate_all(list(combinations(range(len(cameras)), 2)), cameras, tracklets)
    on_share(0.6)
    bodies = gather_bodies(tracklets, relatives, len(cameras))
    posed = pose_cameras(cameras, relatives, bodies, not has_intrinsics)
    linked = people_checks.require_linked_by_people(cameras, posed, relatives)
    on_share(0.8)
    fitted = adjust_people_rig(linked, bodies, instants_s, has_free_lenses=not has_intrinsics)
    world = people_checks.world_or_refused(find_people_world(fitted.cameras, bodies, stature_m, rate_hz))
    on_share(1.0)
    result = _made(fitted, world, bodies, stature_m, has_intrinsics, rate_hz)
    if not known_points:
        return result
    placed = place_by_points(result.cameras, known_points, keeps_scale=False)
    return replace(result, cameras=placed.cameras, world=placed.world, warnings=(*result.warnings, *placed.warnings))


def _relate_all(
    pairs: Sequence[tuple[int, int]], cameras: Sequence[Camera], tracklets: Sequence[ViewTracklet]
) -> list[RelativePose]:
    focal_px = np.array([camera.matrix[0, 0] for camera in cameras])
    return [pose for pair in pairs if (pose := relate_by_people(pair, tracklets, focal_px)) is not None]


def _with_likely_focals(cameras: Sequence[Camera], tracklets: Sequence[ViewTracklet]) -> tuple[Camera, ...]:
    """Cameras with the focal length, the same over the guessed one for all, with which most people fit."""
    seen = np.zeros(len(cameras))
    for tracklet in tracklets:
        seen[tracklet.camera] += len(tracklet.points_px)
    pairs = sorted(combinations(range(len(cameras)), 2), key=lambda pair: -min(seen[list(pair)]))[:_PAIRS_TRIED]

    def support(tried: Sequence[Camera]) -> float:
        with_focals = [with_camera(tracklet, tried[tracklet.camera]) for tracklet in tracklets]
        return sum(pose.support for pose in _relate_all(pairs, tried, with_focals))

    return max((tuple(_with_focal(camera, factor) for camera in cameras) for factor in _FOCAL_FACTORS), key=support)


def _with_focal(camera: Camera, factor: float) -> Camera:
    matrix = camera.matrix.copy()
    matrix[:2, :2] *= factor
    return replace(camera, matrix=read_only(matrix), distortion=read_only(np.zeros(4)))


def _made(
    fitted: PeopleFit,
    world: PeopleWorld,
    bodies: MatchedBodies,
    stature_m: Sequence[float],
    has_intrinsics: bool,
    rate_hz: float,
) -> CalibrationResult:
    is_seen = np.asarray(bodies.seen().any(-1))
    num_views = [len(np.unique(bodies.instant[of_camera])) for of_camera in is_seen.T]
    reports = tuple(
        report_camera(camera, fitted.error_px[number], num_views[number], fitted.sigma[number], world.scale)
        for number, camera in enumerate(world.cameras)
    )
    statures = " and ".join(f"{height_m:.2f} m" for height_m in stature_m)
    return CalibrationResult(
        world.cameras,
        has_extrinsics=True,
        by_camera=reports,
        reprojection_error_px=float(np.nanmedian(fitted.error_px)),
        warnings=tuple(people_checks.people_warnings(reports, fitted.fitting, world, stature_m, rate_hz)),
        world=(
            f"Z up, floor under the feet, origin under the middle of the people, y away from {world.cameras[0].name}; "
            f"scale from a stature of {statures}."
        ),
    )


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
