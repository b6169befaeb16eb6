"""A rig placed in the world by known points: Umeyama's alignment, then the least reprojection error."""

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from pipeline.calibration.known_points.point_checks import MIN_POINTS, point_problems
from pipeline.calibration.similarity import Similarity, umeyama
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import InputError, Problem
from pipeline.core.options.job_choices import MAX_KNOWN_POINTS, MAX_POINT_M, POINT_COLUMNS, KnownPoint
from pipeline.core.parsing import open_table
from pipeline.core.problems.finding_codes import KNOWN_POINTS_DOUBTFUL
from pipeline.core.problems.session_codes import KNOWN_POINTS_FEW, KNOWN_POINTS_INVALID, KNOWN_POINTS_MISFIT
from pipeline.geometry.camera import center_in_world, project, projection_matrices
from pipeline.geometry.triangulation import triangulate
from pipeline.geometry.undistortion import undistort_views

_MAX_BYTES = 4 << 20
_HINT = f"The first line names the columns {','.join(POINT_COLUMNS)}; each further line is a view of a point."


def read_known_points(path: Path) -> tuple[KnownPoint, ...]:
    """Read points from a table. Raises ``InputError`` with all problems of the table."""
    problems: list[Problem] = []
    points: dict[str, KnownPoint] = {}

    def invalid(message: str, hint: str | None = _HINT) -> None:
        problems.append(Problem(KNOWN_POINTS_INVALID, message, file=path.name, hint=hint))

    try:
        if path.stat().st_size > _MAX_BYTES:
            raise InputError([Problem(KNOWN_POINTS_INVALID, "The table is too large.", file=path.name)])
        with open_table(path) as table:
            if fault := table.fault(POINT_COLUMNS):
                invalid(fault)
            for line, row in () if fault else table.rows:
                _add(points, row, line, invalid)
    except (OSError, ValueError, csv.Error):
        invalid("The table can't be read.")
    if len(points) > MAX_KNOWN_POINTS:
        invalid(f"The table has {len(points)} points; at most {MAX_KNOWN_POINTS} are taken.", None)
    if problems:
        raise InputError(problems)
    return tuple(points.values())


def _add(points: dict[str, KnownPoint], row: Mapping[str, str], line: int, invalid: Callable[..., None]) -> None:
    name, camera = row["name"], row["camera"]
    try:
        x_m, y_m, z_m, x_px, y_px = (float(row[column]) for column in POINT_COLUMNS if column not in {"name", "camera"})
    except ValueError:
        invalid(f"Line {line} has a coordinate that is not a number.")
        return
    if not name or not camera:
        invalid(f"Line {line} lacks the name of a point or of a camera.")
    elif not all(map(isfinite, (x_px, y_px))) or not all(abs(value) <= MAX_POINT_M for value in (x_m, y_m, z_m)):
        invalid(f"Line {line} has a coordinate that is not finite, or is farther than {MAX_POINT_M:g} m away.", None)
    elif (known := points.get(name)) is not None and known.xyz_m != (x_m, y_m, z_m):
        invalid(
            f"Line {line} gives the point {name} other coordinates than an earlier line.", "Give it the same in all."
        )
    else:
        seen = () if known is None else known.seen_px
        points[name] = KnownPoint(name, (x_m, y_m, z_m), (*seen, (camera, x_px, y_px)))


# Distances of the points from where cameras see them, as metres and as a share of the points' extent: above the first
# limit a warning, above the second one an error.
_DOUBTFUL, _WRONG = (0.01, 0.005), (0.05, 0.02)
# Largest ratio of the scale of the points and of the rig: of a board, whose size is known, and of people.
_MAX_RATIO = {True: 1.03, False: 1.5}
# Factors between units of length.
_UNITS = {1000.0: "millimetres", 100.0: "centimetres", 1 / 0.0254: "inches", 1 / 0.3048: "feet"}
_UNIT_TOLERANCE = 1.15
# A wrong point leaves at least this many times the error that remains without it; so does a mirrored world.
_BETTER = 4.0
# Scale of the Cauchy loss of a marked point, and the residual of a point behind a camera.
_MARK_PX, _BEHIND_PX = 2.0, 1e4
_FEW = 4


@dataclass(frozen=True, slots=True, eq=False)
class PlacedRig:
    """Cameras in the world of the known points."""

    cameras: tuple[Camera, ...]  # The cameras there
    scale: float  # Factor by which the rig grew; 1 if its size was known
    world: str  # Sentence for the report
    warnings: tuple[Problem, ...]  # Doubts


def place_by_points(cameras: Sequence[Camera], points: Sequence[KnownPoint], keeps_scale: bool) -> PlacedRig:
    """Move cameras as a whole into the world of known points.

    Parameters
    ----------
    cameras
        Cameras of a rig in any world.
    points
        World coordinates in metres, and the pixels that cameras see.
    keeps_scale
        Whether the size of the rig is known, by a board; else the points state it.

    Returns
    -------
    PlacedRig
        Cameras in the world of the points, in metres, and what is doubtful.

    Raises
    ------
    InputError
        If fewer than three points are seen by two cameras, if they are on a line, or if they don't fit.

    References
    ----------
    Umeyama, "Least-squares estimation of transformation parameters between two point patterns" (1991).

    Examples
    --------
    >>> from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras
    >>> cameras = build_cameras(Rig(Layout.RING, 3, (3.0, 2.5), 2.0), np.random.default_rng(0))
    >>> points_m = np.array([[0.0, 0.0, 1.0], [0.5, 0.0, 1.2], [0.0, 0.5, 1.1], [0.2, 0.3, 1.4]])
    >>> seen_px = {camera.name: project(camera, points_m) for camera in cameras}
    >>> points = [
    ...     KnownPoint(f"P{k}", tuple(xyz_m), tuple((name, *px[k]) for name, px in seen_px.items()))
    ...     for k, xyz_m in enumerate(points_m)
    ... ]
    >>> placed = place_by_points(cameras, points, keeps_scale=False)
    >>> round(placed.scale, 6)
    1.0
    """
    if problems := point_problems(points, {camera.name: camera.size_px for camera in cameras}):
        raise InputError(problems)
    seen_px = _seen_px(cameras, points)
    found_m = _triangulated(cameras, seen_px)
    is_found = np.isfinite(found_m).all(-1)
    if is_found.sum() < MIN_POINTS:
        message = f"{is_found.sum()} of the points have a place in space: the rays of the others are parallel."
        hint = "Mark the points in cameras that see them from different sides."
        raise InputError([Problem(KNOWN_POINTS_FEW, message, field="known_points", hint=hint)])
    goal_m = np.array([point.xyz_m for point in points])
    names = [point.name for point, is_located in zip(points, is_found, strict=True) if is_located]
    problems = _misfits(found_m[is_found], goal_m[is_found], names, keeps_scale)
    if problems:
        raise InputError(problems)
    start = umeyama(found_m[is_found], goal_m[is_found], has_scale=not keeps_scale)
    similarity = _least_error(cameras, start, goal_m, seen_px, keeps_scale)
    placed = tuple(similarity.moved(camera) for camera in cameras)
    distance_m = np.linalg.norm(similarity.apply(found_m) - goal_m, axis=-1)
    error_px = np.linalg.norm(np.stack([project(camera, goal_m) for camera in placed]) - seen_px, axis=-1)
    worst = int(np.nanargmax(distance_m))
    world = (
        f"World of {len(points)} known points, seen {1000 * np.nanmedian(distance_m):.1f} mm from their "
        f"coordinates (median; {points[worst].name} {1000 * distance_m[worst]:.1f} mm), "
        f"{np.nanmedian(error_px):.1f} px in the pictures."
    )
    return PlacedRig(placed, similarity.scale, world, _doubts(placed, goal_m, distance_m, points[worst].name))


def _seen_px(cameras: Sequence[Camera], points: Sequence[KnownPoint]) -> Float[np.ndarray, "cameras points 2"]:
    numbers = {camera.name: number for number, camera in enumerate(cameras)}
    seen_px = np.full((len(cameras), len(points), 2), np.nan)
    for k, point in enumerate(points):
        for name, x_px, y_px in point.seen_px:
            seen_px[numbers[name], k] = x_px, y_px
    return seen_px


def _triangulated(
    cameras: Sequence[Camera], seen_px: Float[np.ndarray, "cameras points 2"]
) -> Float[np.ndarray, "points 3"]:
    ideal_px = undistort_views(cameras, seen_px[None])[0]
    return triangulate(projection_matrices(cameras), ideal_px, np.ones(ideal_px.shape[:2]))


def _limit_m(goal_m: Float[np.ndarray, "points 3"], limit: tuple[float, float]) -> float:
    return limit[0] + limit[1] * float(np.linalg.norm(np.ptp(goal_m, axis=0)))


def _misfits(
    found_m: Float[np.ndarray, "points 3"],
    goal_m: Float[np.ndarray, "points 3"],
    names: Sequence[str],
    keeps_scale: bool,
) -> list[Problem]:
    """Reason for which points don't fit: their unit, a mirrored axis, or a single wrong point."""
    free = umeyama(found_m, goal_m, has_scale=True)
    limit_m = _limit_m(goal_m, _WRONG)
    left_m = _error_m(free, found_m, goal_m)
    if left_m <= limit_m and max(free.scale, 1 / free.scale) <= _MAX_RATIO[keeps_scale]:
        return []
    of_rig = "the board" if keeps_scale else "the statures"
    if left_m <= limit_m:
        message = f"The points are {free.scale:.4g} times as far apart as they are by {of_rig}."
        unit = next((name for factor, name in _UNITS.items() if _is_near(free.scale, factor)), None)
        hint = "State metres." if unit else f"Check the unit of the points, and the size of {of_rig}."
        return [_misfit(f"{message} They seem to be in {unit}." if unit else message, hint)]
    mirrored = umeyama(found_m, goal_m, has_scale=True, is_mirrored=True)
    if _BETTER * _error_m(mirrored, found_m, goal_m) < left_m:
        message = "The points fit only when they are mirrored."
        return [_misfit(message, "Use right-handed axes: exchange x and y, or turn the sign of one axis.")]
    message = f"The points are seen {left_m:.2f} m from their coordinates (root mean square)."
    hint = "Check the names, the coordinates and the marked pixels of the points."
    if len(names) >= _FEW:
        without = [_error_without(k, found_m, goal_m) for k in range(len(names))]
        best = int(np.argmin(without))
        if _BETTER * without[best] < left_m:
            hint = f"Check {names[best]}: without it the others fit within {without[best]:.3f} m."
    return [_misfit(message, hint)]


def _is_near(ratio: float, factor: float) -> bool:
    return max(ratio / factor, factor / ratio) < _UNIT_TOLERANCE


def _misfit(message: str, hint: str) -> Problem:
    return Problem(KNOWN_POINTS_MISFIT, message, field="known_points", hint=hint)


def _error_m(
    similarity: Similarity, found_m: Float[np.ndarray, "points 3"], goal_m: Float[np.ndarray, "points 3"]
) -> float:
    return float(np.sqrt(((similarity.apply(found_m) - goal_m) ** 2).sum(-1).mean()))


def _error_without(k: int, found_m: Float[np.ndarray, "points 3"], goal_m: Float[np.ndarray, "points 3"]) -> float:
    kept_m, kept_goal_m = np.delete(found_m, k, axis=0), np.delete(goal_m, k, axis=0)
    return _error_m(umeyama(kept_m, kept_goal_m, has_scale=True), kept_m, kept_goal_m)


def _least_error(
    cameras: Sequence[Camera],
    start: Similarity,
    goal_m: Float[np.ndarray, "points 3"],
    seen_px: Float[np.ndarray, "cameras points 2"],
    keeps_scale: bool,
) -> Similarity:
    """Similarity with the least reprojection error of the known points: near cameras then count more than far ones."""
    is_seen = np.isfinite(seen_px).all(-1)

    def stepped(step: Float[np.ndarray, " unknowns"]) -> Similarity:
        turn = Rotation.from_rotvec(step[:3]).as_matrix()
        factor = 1.0 if keeps_scale else float(np.exp(step[6]))
        centre_m = goal_m.mean(0)
        shifted_m = factor * turn @ (start.translation_m - centre_m) + centre_m + step[3:6]
        return Similarity(start.scale * factor, turn @ start.rotation, shifted_m)

    def residuals_px(step: Float[np.ndarray, " unknowns"]) -> Float[np.ndarray, " residuals"]:
        similarity = stepped(step)
        projected_px = np.stack([project(similarity.moved(camera), goal_m) for camera in cameras])
        return np.nan_to_num((projected_px - seen_px)[is_seen], nan=_BEHIND_PX).ravel()

    unknowns = np.zeros(6 if keeps_scale else 7)
    return stepped(least_squares(residuals_px, unknowns, loss="cauchy", f_scale=_MARK_PX, x_scale=0.01).x)


def _doubts(
    cameras: Sequence[Camera],
    goal_m: Float[np.ndarray, "points 3"],
    distance_m: Float[np.ndarray, " points"],
    worst: str,
) -> tuple[Problem, ...]:
    doubts = []
    if np.nanmax(distance_m) > _limit_m(goal_m, _DOUBTFUL):
        message = f"The point {worst} is seen {np.nanmax(distance_m):.3f} m from its coordinates."
        hint = "Check its coordinates and its marked pixels."
        doubts.append(Problem(KNOWN_POINTS_DOUBTFUL, message, field="known_points", hint=hint))
    heights_m = np.array([center_in_world(camera)[2] for camera in cameras])
    if (heights_m < goal_m[:, 2].min()).all():
        message = "All cameras are below the points."
        hint = "Z must point up and the axes must be right-handed: exchange x and y if the world is mirrored."
        doubts.append(Problem(KNOWN_POINTS_DOUBTFUL, message, field="known_points", hint=hint))
    return tuple(doubts)
