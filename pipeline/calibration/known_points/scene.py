"""Calibration from a scene: known points, marked in one picture of each camera, give its pose.

Points that don't fit are named with their errors, and so are pairs that fit when they are exchanged. A point that
several cameras see at another place has wrong coordinates.
"""

from collections.abc import Container, Iterator, Mapping, Sequence

import numpy as np

from pipeline.calibration.camera_names import MAX_NAME_LENGTH, name_problem
from pipeline.calibration.checks.camera_checks import check_places
from pipeline.calibration.contents import UNKNOWN_SIZE
from pipeline.calibration.known_points.point_checks import Size, scene_problems
from pipeline.calibration.known_points.scene_pose import Marks, PoseFit, locate, locate_by_all
from pipeline.calibration.report import CalibrationResult, CameraReport, PointReport
from pipeline.calibration.sizes import fit_to_picture, guessed_camera
from pipeline.calibration.validate import MAX_CAMERAS
from pipeline.calibration.vertical import AXES, turned_upright
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import InputError, Problem, listed_names
from pipeline.core.options.job_choices import KnownPoint, Up
from pipeline.core.problems.finding_codes import KNOWN_POINTS_DOUBTFUL
from pipeline.core.problems.session_codes import (
    CAMERA_UNKNOWN,
    INVALID_NAME,
    INVALID_SIZE,
    KNOWN_POINTS_MISFIT,
    TOO_MANY_CAMERAS,
)
from pipeline.geometry.camera import project, projection_matrices
from pipeline.geometry.triangulation import triangulate
from pipeline.geometry.undistortion import undistort_views

# Root mean square error that is a doubt, as a share of the picture's longer side; deviations that are a doubt: of the
# place as a share of the distance to the points, and of the focal length.
_DOUBTFUL, _VAGUE_PLACE, _VAGUE_FOCAL_PERCENT = 0.003, 0.05, 5.0
# Another pose is possible if its error is at most so many times the error, and one pixel, higher.
_RIVAL = 2.0
_FIELD = "known_points"


def scene_cameras(
    points: Sequence[KnownPoint], sizes_px: Mapping[str, Size], intrinsics: Sequence[Camera] | None
) -> tuple[Camera, ...]:
    """Cameras that see points, with lenses at the sizes of their pictures; guessed lenses without ``intrinsics``.

    ``sizes_px`` are by camera, and of the other cameras under an empty name. Raises ``InputError`` if the lens or the
    size of a camera is missing, or they don't fit.
    """
    lenses = {lens.name: lens for lens in intrinsics or ()}
    names = dict.fromkeys([*filter(None, sizes_px), *(name for point in points for name, _, _ in point.seen_px)])
    cameras: list[Camera] = []
    problems = []
    if len(names) > MAX_CAMERAS:
        raise InputError([Problem(TOO_MANY_CAMERAS, f"A scene has at most {MAX_CAMERAS} cameras.", field=_FIELD)])
    for name in names:
        lens = lenses.get(name)
        size_px = sizes_px.get(name) or sizes_px.get("") or (UNKNOWN_SIZE if lens is None else lens.size_px)
        if wrong := name_problem(name):
            problems.append(
                Problem(INVALID_NAME, f"The name of a camera {wrong}", None, name[:MAX_NAME_LENGTH], _FIELD)
            )
        elif lens is None and intrinsics is not None:
            hint = f"It has {listed_names(sorted(lenses))}."
            problems.append(
                Problem(CAMERA_UNKNOWN, "The calibration has no camera of this name.", None, name, hint=hint)
            )
        elif size_px == UNKNOWN_SIZE:
            hint = "State the width and the height of its picture."
            problems.append(Problem(INVALID_SIZE, "The size of the picture is not known.", None, name, "size", hint))
        elif lens is None or lens.size_px == size_px:
            cameras.append(lens or guessed_camera(name, size_px))
        elif (fitted := fit_to_picture(lens, size_px, 0)) is not None:
            cameras.append(fitted[0])
        else:
            message = f"A lens of {lens.size_px[0]} x {lens.size_px[1]} does not fit {size_px[0]} x {size_px[1]}."
            hint = "Calibrate the lens at the size of the picture."
            problems.append(Problem(INVALID_SIZE, message, None, name, "size", hint))
    if problems:
        raise InputError(problems)
    return tuple(cameras)


def calibrate_scene(
    cameras: Sequence[Camera], points: Sequence[KnownPoint], has_intrinsics: bool, up: Up = "z"
) -> CalibrationResult:
    """Calibrate cameras from known points that each of them sees, by SQPnP (Terzakis and Lourakis 2020) and planes.

    - ``cameras``: cameras with sizes of pictures; their poses are ignored.
    - ``points``: world coordinates in metres, and the pixels that cameras see.
    - ``has_intrinsics``: the lenses are known. Else focal lengths and first radial coefficients are estimated.
    - ``up``: axis of the points' world that points up; it becomes Z.
    - Raises ``InputError``: with too few points of a camera, points on a line, and points that don't fit.

    >>> from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras
    >>> cameras = build_cameras(Rig(Layout.RING, 2, (3.0, 2.5), 2.0), np.random.default_rng(0))
    >>> corners_m = np.array([[x, y, z] for x in (0.0, 0.8) for y in (0.0, 0.6) for z in (0.4, 1.2)])
    >>> seen_px = {camera.name: project(camera, corners_m) for camera in cameras}
    >>> points = [
    ...     KnownPoint(f"P{k}", tuple(xyz_m), tuple((name, *px[k]) for name, px in seen_px.items()))
    ...     for k, xyz_m in enumerate(corners_m)
    ... ]
    >>> found = calibrate_scene(cameras, points, has_intrinsics=True)
    >>> round(found.reprojection_error_px, 3)
    0.0
    """
    sizes_px = {camera.name: camera.size_px for camera in cameras}
    if problems := scene_problems(points, sizes_px, has_intrinsics):
        raise InputError(problems)
    marks = [_marks(camera, points) for camera in cameras]
    fits = [locate(camera, seen, has_intrinsics) for camera, seen in zip(cameras, marks, strict=True)]
    misplaced = _misplaced(fits, marks, points)
    problems = list(misplaced.values())
    for fit, seen in zip(fits, marks, strict=True):
        problems += _misfits(fit, seen, has_intrinsics, misplaced)
    if problems:
        raise InputError(problems)
    placed = tuple(fit.camera for fit in fits)
    doubts = [problem for fit, seen in zip(fits, marks, strict=True) for problem in _doubts(fit, seen)]
    if up != "z":
        placed = turned_upright(placed, AXES[up])
    doubts += [Problem(each.code, each.message, camera=each.camera, hint=each.hint) for each in check_places(placed)]
    error_px = np.concatenate([fit.error_px for fit in fits])
    world = (
        f"World of {len(points)} known points, which fit by {np.sqrt((error_px**2).mean()):.1f} px (root mean square)."
    )
    if not has_intrinsics:
        world += " Lenses are estimated from the points: focal length and radial distortion."
    reports = tuple(_report(fit, seen) for fit, seen in zip(fits, marks, strict=True))
    return CalibrationResult(placed, True, reports, float(np.median(error_px)), tuple(doubts), world)


def _marks(camera: Camera, points: Sequence[KnownPoint]) -> Marks:
    seen = [(point, x_px, y_px) for point in points for name, x_px, y_px in point.seen_px if name == camera.name]
    return Marks(
        [point.name for point, _, _ in seen],
        np.array([point.xyz_m for point, _, _ in seen], float),
        np.array([[x_px, y_px] for _, x_px, y_px in seen], float),
    )


def _misplaced(fits: Sequence[PoseFit], marks: Sequence[Marks], points: Sequence[KnownPoint]) -> dict[str, Problem]:
    """Points that all their cameras see at one place, which is not the place of their coordinates."""
    problems = {}
    for point in points:
        views = [
            (fit, seen.names.index(point.name), seen)
            for fit, seen in zip(fits, marks, strict=True)
            if point.name in seen.names and fit.is_agreed
        ]
        if len(views) < 2 or not all(fit.is_wrong[k] for fit, k, _ in views):
            continue
        cameras = [fit.camera for fit, _, _ in views]
        seen_px = np.array([[seen.seen_px[k]] for _, k, seen in views])
        ideal_px = undistort_views(cameras, seen_px[None])[0]
        (place_m,) = triangulate(projection_matrices(cameras), ideal_px, np.ones(ideal_px.shape[:2]))
        off_px = [np.linalg.norm(project(camera, place_m) - px) for camera, (px,) in zip(cameras, seen_px, strict=True)]
        if all(px <= fit.limit_px for px, (fit, _, _) in zip(off_px, views, strict=True)):
            names = ", ".join(camera.name for camera in cameras)
            message = f"The coordinates of the point {point.name} are wrong: {names} see it at another place."
            hint = f"They see it at {', '.join(f'{value:.3f}' for value in place_m)} m. Measure it again."
            problems[point.name] = Problem(KNOWN_POINTS_MISFIT, message, field=_FIELD, hint=hint)
    return problems


def _misfits(fit: PoseFit, marks: Marks, has_intrinsics: bool, misplaced: Container[str]) -> Iterator[Problem]:
    """Report points of a camera that are errors, except the misplaced ones."""
    camera, wrong = fit.camera, np.flatnonzero(fit.is_wrong).tolist()

    def problem(message: str, hint: str) -> Problem:
        return Problem(KNOWN_POINTS_MISFIT, message, camera=camera.name, field=_FIELD, hint=hint)

    if wrong and not fit.is_agreed:
        yield problem(*_reason(fit, marks, has_intrinsics))
        return
    projected_px = project(camera, marks.xyz_m)
    for k in wrong:
        if marks.names[k] in misplaced:
            continue
        without = "without it" if len(wrong) == 1 else "without such points"
        message = (
            f"The point {marks.names[k]} is {fit.error_px[k]:.0f} px off; {without} the error is {fit.rms_px:.1f} px."
        )
        hint = "Mark it again, or check its coordinates."
        for j in wrong:
            # Each of two exchanged points is marked where the other one is seen.
            off_px = np.linalg.norm(projected_px[[j, k]] - marks.seen_px[[k, j]], axis=-1)
            if j != k and off_px.max() <= fit.limit_px:
                hint = f"It is exchanged with {marks.names[j]}: mark each where the other one is."
        yield problem(message, hint)


def _reason(fit: PoseFit, marks: Marks, has_intrinsics: bool) -> tuple[str, str]:
    """Message and hint for a camera whose points agree on no pose."""
    if fit.is_mirrored:
        message = "The points fit only when they are mirrored."
        return message, "Use right-handed axes: exchange x and y, or turn the sign of one axis."
    by_all = locate_by_all(fit.camera, marks, has_intrinsics)
    error = "have no pose" if by_all is None else f"are {by_all.rms_px:.0f} px off"
    lens = "the size of the picture and the lens" if has_intrinsics else "the lens, which a calibration would state"
    message = f"The {len(marks.names)} points {error} (root mean square), and no half of them fits."
    return message, f"Check the names and the coordinates of the points, and {lens}. More points show which are wrong."


def _doubts(fit: PoseFit, marks: Marks) -> Iterator[Problem]:
    camera, worst = fit.camera, int(np.argmax(fit.error_px))

    def doubt(message: str, hint: str) -> Problem:
        return Problem(KNOWN_POINTS_DOUBTFUL, message, camera=camera.name, field=_FIELD, hint=hint)

    if fit.rms_px > _DOUBTFUL * max(camera.size_px):
        message = f"The points are {fit.rms_px:.1f} px off, {marks.names[worst]} {fit.error_px[worst]:.1f} px."
        yield doubt(message, f"Check {marks.names[worst]}: its mark and its coordinates; and the lens.")
    further = "Mark more points, far apart in the picture and not all in one plane."
    distance_m = float(np.linalg.norm(camera.cam_from_world.apply(marks.xyz_m.mean(0))))
    if fit.rival_px <= _RIVAL * fit.rms_px + 1.0:
        message = f"Another place of the camera explains the points nearly as well ({fit.rival_px:.1f} px)."
        yield doubt(message, further)
    elif fit.place_sigma_m > _VAGUE_PLACE * distance_m:
        message = f"The points leave the place of the camera uncertain by {fit.place_sigma_m:.2f} m."
        yield doubt(message, further)
    if fit.focal_sigma_percent > _VAGUE_FOCAL_PERCENT:
        message = f"The points leave the focal length uncertain by {fit.focal_sigma_percent:.0f} %."
        yield doubt(message, f"Give a calibration of the lens. {further}")


def _report(fit: PoseFit, marks: Marks) -> CameraReport:
    projected_px = project(fit.camera, marks.xyz_m).tolist()
    return CameraReport(
        fit.camera.name,
        float(np.median(fit.error_px)),
        float(fit.camera.matrix.diagonal()[:2].mean()),
        1,
        fit.focal_sigma_percent or np.nan,
        1000 * fit.place_sigma_m,
        fit.turn_sigma_deg,
        tuple(map(PointReport, marks.names, fit.error_px.tolist(), projected_px)),
    )
