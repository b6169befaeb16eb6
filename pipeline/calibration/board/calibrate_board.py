"""Calibration from views of a board: the whole way."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from pipeline.calibration.adjustment.parameters import FOCAL, NUM_PARAMETERS
from pipeline.calibration.board import board_adjustment, board_checks
from pipeline.calibration.board.board_rig import BoardRig, match_times, relate_by_board, spanning_tree
from pipeline.calibration.board.board_world import BoardWorld, chosen_instants, find_board_world, find_places
from pipeline.calibration.board.intrinsics import Intrinsics, calibrate_intrinsics
from pipeline.calibration.board.poses import BoardMotion, possible_poses
from pipeline.calibration.board.spec import Board
from pipeline.calibration.board.views import BoardViews, choose_views, coverage_svg
from pipeline.calibration.known_points.fit import place_by_points
from pipeline.calibration.known_points.point_checks import point_problems
from pipeline.calibration.report import CalibrationResult, report_camera
from pipeline.calibration.similarity import move_world
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.core.errors import InputError, Problem
from pipeline.core.options.job_choices import KnownPoint
from pipeline.core.problems.session_codes import KNOWN_POINTS_INVALID
from pipeline.core.progress import OnShare, ignore
from pipeline.geometry.camera import center_in_world

# Instants to which the whole rig is fitted.
_INSTANTS = 160
# Instants among which the floor is looked for.
_FLOOR_INSTANTS = 600
_INTRINSICS_ONLY = "None: the photographs have no times, or there is one camera. Every pose is the identity."


def calibrate_board(
    views: Sequence[BoardViews],
    board: Board,
    given: Mapping[str, Camera] | None = None,
    frame_rate_hz: float = 0.0,
    floor_time_s: float | None = None,
    on_share: OnShare = ignore,
    known_points: Sequence[KnownPoint] = (),
) -> CalibrationResult:
    """Calibrate cameras from views of a board.

    Intrinsics are calibrated camera by camera. Poses of pairs of cameras, found from the instants at which both see the
    board, link the cameras by a spanning tree; then all is adjusted together.

    Parameters
    ----------
    views, board
        Corners in pixels and times in seconds of each camera's pictures; the board, whose squares give the scale.
    given
        Cameras whose intrinsics are known, by name: they stay. ``None``: intrinsics are calibrated.
    frame_rate_hz
        Rate of the videos: views within half a frame are of one instant. 0 for photographs.
    floor_time_s
        See ``find_places``.
    known_points
        Points that determine the world, in place of the board on the floor.

    Returns
    -------
    CalibrationResult
        Cameras, world in metres with Z up, and what is doubtful.

    Raises
    ------
    InputError
        If a camera has too few views, if cameras share too few, or if they or the known points disagree.

    References
    ----------
    Zhang, "A flexible new technique for camera calibration" (2000), for the intrinsics.

    Examples
    --------
    >>> from scipy.spatial.transform import Rotation
    >>> from pipeline.calibration.board.spec import parse_board
    >>> from pipeline.core.data.rigid import Rigid3
    >>> from pipeline.geometry.camera import project
    >>> from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras
    >>> rng, board = np.random.default_rng(0), parse_board("charuco:7x5:0.12:0.09:DICT_4X4_50")
    >>> cameras = build_cameras(Rig(Layout.RING, 2, (3.0, 2.5), 2.0), rng)
    >>> turns = Rotation.from_euler("xyz", rng.uniform(-0.5, 0.5, (20, 3))).as_matrix()
    >>> poses = [Rigid3(turn, np.array([0.0, 0.0, 1.0])) for turn in turns]
    >>> views = [
    ...     BoardViews(
    ...         camera.name, camera.size_px, np.arange(20.0),
    ...         np.stack([project(camera, pose.apply(board.corners_m)) for pose in poses]), np.ones(20), 20,
    ...     )
    ...     for camera in cameras
    ... ]
    >>> found = calibrate_board(views, board, {camera.name: camera for camera in cameras}, frame_rate_hz=1.0)
    >>> found.has_extrinsics, found.reprojection_error_px < 0.01
    (True, True)
    """
    board_checks.require_views(views, board, needs_intrinsics=given is None)
    has_times = all(np.isfinite(camera_views.time_s).all() for camera_views in views)
    if known_points and (problems := _point_problems(views, known_points, has_times)):
        raise InputError(problems)
    intrinsics = [None if given is not None else calibrate_intrinsics(camera_views, board) for camera_views in views]
    on_share(0.3)
    cameras = tuple(
        calibrated.camera if calibrated is not None else _unposed(given, camera_views.camera)
        for calibrated, camera_views in zip(intrinsics, views, strict=True)
    )
    if len(views) == 1 or not has_times:
        return _intrinsics_only(views, intrinsics, cameras)
    rig = BoardRig(
        tuple(views),
        cameras,
        tuple(
            tuple(possible_poses(camera, corners, board) for corners in camera_views.corners_px)
            for camera, camera_views in zip(cameras, views, strict=True)
        ),
        match_times([camera_views.time_s for camera_views in views], 0.5 / frame_rate_hz if frame_rate_hz else 0.0),
    )
    on_share(0.5)
    related = (relate_by_board(k, m, rig.shared(k, m)) for k, m in combinations(range(len(views)), 2))
    pairs = [pair for pair in related if pair is not None]
    usable = board_checks.require_linked_by_board(rig, pairs, frame_rate_hz)
    root_poses = spanning_tree(len(views), usable)
    root = next(number for number, pose in root_poses.items() if not pose.translation_m.any())
    posed = {number: replace(cameras[number], cam_from_world=pose) for number, pose in root_poses.items()}
    on_share(0.6)
    placed = _place_all(rig, posed, board, _chosen_instants(rig, board))
    coefficients = None if given is not None else [lens.model.free for lens in intrinsics if lens is not None]
    board_checks.require_placed(rig, [placed_board for _, placed_board in placed])
    boards = [[placed_board] for _, placed_board in placed]
    fitted = board_adjustment.adjust_board_rig([posed[k] for k in range(len(views))], root, boards, board, coefficients)
    on_share(0.75)
    doubts = (*board_checks.view_warnings(views), *board_checks.link_warnings(views, usable))
    motion = _motion(rig, fitted.adjustment.cameras, board)
    centers_m = np.array([center_in_world(camera) for camera in fitted.adjustment.cameras])
    # The board's poses on the floor are adjusted with everything else: each of them has many instants.
    places = None if known_points else find_places(motion, centers_m, floor_time_s)
    on_floor = (
        [] if places is None else [[motion.boards[k] for k in chosen_instants(stretch)] for stretch in places.stretches]
    )
    boards = [
        [replace(board_once, root_from_board=pose)]
        for (board_once,), pose in zip(boards, fitted.root_from_boards, strict=True)
    ]
    speed = [motion.speed_at(seen.mean_time_s) for (seen,) in boards]
    speed += [np.zeros(6) for _ in on_floor]
    fitted = board_adjustment.adjust_board_rig(
        fitted.adjustment.cameras, root, [*boards, *on_floor], board, coefficients, np.array(speed)
    )
    on_share(0.95)
    doubts = (*doubts, *board_checks.agreement_warnings(views, fitted))
    if places is None:
        rig_in_world = place_by_points(fitted.adjustment.cameras, known_points, keeps_scale=True)
        return _made(views, fitted, rig_in_world.cameras, rig_in_world.world, (*doubts, *rig_in_world.warnings))
    world = find_board_world(
        fitted.root_from_boards[-len(on_floor) :], fitted.last_covariance(len(on_floor)), board.corners_m.mean(0)
    )
    begins_s = [float(motion.time_s[stretch.start]) for stretch in places.stretches]
    cameras = move_world(fitted.adjustment.cameras, world.world_from_root)
    doubts = (*doubts, *board_checks.floor_warnings(places, begins_s[0], board))
    return _made(views, fitted, cameras, _world_sentence(world, begins_s, board), doubts)


def _point_problems(views: Sequence[BoardViews], known_points: Sequence[KnownPoint], has_times: bool) -> list[Problem]:
    """Problems of the known points that can be told before anything is calibrated."""
    if len(views) == 1 or not has_times:
        message = "Photographs and single cameras give intrinsics only: there is no world for known points."
        return [Problem(KNOWN_POINTS_INVALID, message, field="known_points", hint="Give videos of all cameras.")]
    return point_problems(known_points, {camera_views.camera: camera_views.size_px for camera_views in views})


def _unposed(given: Mapping[str, Camera] | None, name: str) -> Camera:
    if given is None:
        raise ValueError("there are no given intrinsics")
    return replace(given[name], cam_from_world=Rigid3(np.eye(3), np.zeros(3)))


def _intrinsics_only(
    views: Sequence[BoardViews], intrinsics: Sequence[Intrinsics | None], cameras: tuple[Camera, ...]
) -> CalibrationResult:
    reports = []
    for camera, calibrated, camera_views in zip(cameras, intrinsics, views, strict=True):
        sigma, error_px = np.full(NUM_PARAMETERS, np.nan), np.nan
        if calibrated is not None:
            sigma[FOCAL], error_px = calibrated.focal_sigma, calibrated.error_px
        reports.append(report_camera(camera, error_px, len(camera_views), sigma))
    return CalibrationResult(
        cameras,
        has_extrinsics=False,
        by_camera=tuple(reports),
        reprojection_error_px=float(np.median([report.reprojection_error_px for report in reports])),
        warnings=tuple(board_checks.view_warnings(views)),
        world=_INTRINSICS_ONLY,
        pictures=_pictures(views),
    )


def _chosen_instants(rig: BoardRig, board: Board) -> list[int]:
    """Instants for the adjustment: for each camera, views that cover its picture, those with more cameras first."""
    num_seeing = (rig.instants >= 0).sum(1)
    chosen: set[int] = set()
    share = max(8, _INSTANTS // len(rig.views))
    for number, views in enumerate(rig.views):
        for has_others in (True, False):
            rows = np.flatnonzero((rig.instants[:, number] >= 0) & ((num_seeing > 1) == has_others))
            most = share if has_others else share // 4
            chosen |= {int(rows[k]) for k in choose_views(views.select(rig.instants[rows, number]), most)}
    return sorted(chosen)


def _place_all(
    rig: BoardRig, posed: Mapping[int, Camera], board: Board, instants: Sequence[int]
) -> list[tuple[int, board_adjustment.PlacedBoard]]:
    """Board at some instants, where it can be placed."""
    boards = []
    for instant in instants:
        seeing = {number: int(view) for number, view in enumerate(rig.instants[instant]) if view >= 0}
        corners = {number: rig.views[number].corners_px[view] for number, view in seeing.items()}
        poses = {number: rig.poses[number][view] for number, view in seeing.items()}
        if (placed := board_adjustment.place_board(posed, corners, poses, board)) is not None:
            times_s = {number: float(rig.views[number].time_s[view]) for number, view in seeing.items()}
            boards.append((instant, replace(placed, time_s=times_s)))
    return boards


def _motion(rig: BoardRig, cameras: Sequence[Camera], board: Board) -> BoardMotion:
    """Board at all instants at which it can be placed, or at many of them."""
    number = len(rig.instants)
    looked_at = np.unique(np.linspace(0, number - 1, min(number, _FLOOR_INSTANTS)).round().astype(int))
    placed = [seen for _, seen in _place_all(rig, dict(enumerate(cameras)), board, looked_at.tolist())]
    boards = board_adjustment.alike_numbered(board_adjustment.refine_boards(cameras, placed, board), board)
    time_s = read_only(np.array([seen.mean_time_s for seen in boards]))
    return BoardMotion(time_s, boards, board.corners_m.mean(0))


def _world_sentence(world: BoardWorld, begins_s: Sequence[float], board: Board) -> str:
    corner = "the first or the last corner" if board.is_ambiguous else "the first corner"
    tilt_deg = np.degrees(world.tilt_sigma_rad)
    others = "".join(f", {begin_s:.2f} s" for begin_s in begins_s[1:])
    places = f"the places at {begins_s[0]:.2f} s{others}" if others else "one place"
    return (
        f"Z up, origin at {corner} of the board, x along its rows, as the board lies at {begins_s[0]:.2f} s. "
        f"The plane rests on {places} (tilt to {tilt_deg:.2f} degrees)."
    )


def _made(
    views: Sequence[BoardViews],
    fitted: board_adjustment.BoardFit,
    cameras: tuple[Camera, ...],
    world: str,
    warnings: tuple[Problem, ...],
) -> CalibrationResult:
    error_px = fitted.adjustment.error_px(fitted.owner)
    reports = tuple(
        report_camera(camera, error_px[number], len(views[number]), fitted.adjustment.sigma[number])
        for number, camera in enumerate(cameras)
    )
    median_px = float(np.nanmedian(np.linalg.norm(fitted.adjustment.residuals_px, axis=-1)))
    return CalibrationResult(cameras, True, reports, median_px, warnings, world, _pictures(views))


def _pictures(views: Sequence[BoardViews]) -> dict[str, str]:
    return {f"coverage_{camera_views.camera}.svg": coverage_svg(camera_views) for camera_views in views}
