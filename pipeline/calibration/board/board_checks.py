"""Checks of the views of a board: what refuses a calibration, and what to film again."""

from collections.abc import Iterator, Sequence

import numpy as np

from pipeline.calibration.board.board_adjustment import BoardFit, PlacedBoard
from pipeline.calibration.board.board_rig import BoardPair, BoardRig, match_times, relate_by_board, spanning_tree
from pipeline.calibration.board.board_world import Places
from pipeline.calibration.board.intrinsics import MIN_VIEWS
from pipeline.calibration.board.spec import Board
from pipeline.calibration.board.views import BoardViews, covered_share
from pipeline.core.errors import InputError, Problem
from pipeline.core.problems import finding_codes
from pipeline.core.problems.session_codes import BOARD_EXCHANGED, BOARD_NOT_FOUND, BOARD_UNLINKED, BOARD_UNSYNCHRONISED

# Two cameras are linked by at least this many instants that agree, and this share of the instants that they share.
_MIN_AGREEING, _MIN_AGREEING_SHARE = 3, 0.4
# Fewer views, covered cells, or shared instants give a warning.
_FEW_VIEWS, _POOR_COVERAGE, _FEW_SHARED = 10, 0.4, 10
# The joint error is far above the cameras' own ones by this factor, and by so many pixels.
_FAR_ABOVE, _FAR_ABOVE_PX = 3.0, 0.3
# A camera is late by at least this time, and by this share of the differences.
_LATE_S, _LATE_SHARE = 0.004, 0.3
# Differences of a moving board are larger by this factor than differences of a still one if time is the cause.
_MOVING = 2.0
# Offsets that are tried for cameras that disagree.
_MAX_OFFSET_S = 2.0
_MIN_SHARED_FOR_OFFSET = 12
_CERTAIN_SHARE = 0.7


def require_views(views: Sequence[BoardViews], board: Board, needs_intrinsics: bool) -> None:
    """Raise ``InputError`` with all cameras in which the board was found too rarely."""
    least = MIN_VIEWS if needs_intrinsics else 1
    problems = [_too_few(camera_views, board, least) for camera_views in views if len(camera_views) < least]
    if problems:
        raise InputError(problems)


def _too_few(views: BoardViews, board: Board, least: int) -> Problem:
    message = f"The board was found in {len(views)} of {views.num_pictures} pictures; at least {least} are required."
    hint = f"Check the board ({board}); film it sharp, well lit and whole."
    if views.num_exchanged:
        shown = board.exchanged
        message = (
            f"The board has {shown.cols} columns and {shown.rows} rows of squares, not {board.cols} and {board.rows}."
        )
        return Problem(BOARD_EXCHANGED, message, camera=views.camera, hint=f"State {shown}.")
    if views.num_mirrored:
        hint = f"In {views.num_mirrored} pictures the board is mirrored: turn off the mirroring of the camera."
    elif board.kind == "chessboard":
        others = f"{board.rows}x{board.cols}, {board.cols - 1}x{board.rows - 1} or {board.cols + 1}x{board.rows + 1}"
        hint = f"{hint} COLSxROWS counts inner corners: {others} may be right."
    return Problem(BOARD_NOT_FOUND, message, camera=views.camera, hint=hint)


def require_linked_by_board(rig: BoardRig, pairs: Sequence[BoardPair], frame_rate_hz: float) -> list[BoardPair]:
    """Pairs that link all cameras.

    Raises ``InputError`` if a camera is not linked: the reason is its views, or its clock.
    """
    usable = [pair for pair in pairs if _is_usable(pair)]
    linked = spanning_tree(len(rig.views), usable)
    problems = [
        _unlinked(rig, number, pairs, frame_rate_hz) for number in range(len(rig.views)) if number not in linked
    ]
    if problems:
        raise InputError(problems)
    return usable


def _is_usable(pair: BoardPair) -> bool:
    return pair.num_agreeing >= _MIN_AGREEING and pair.num_agreeing >= _MIN_AGREEING_SHARE * pair.num_shared


def _unlinked(rig: BoardRig, number: int, pairs: Sequence[BoardPair], frame_rate_hz: float) -> Problem:
    name = rig.views[number].camera
    own = [pair for pair in pairs if number in (pair.first, pair.second)]
    best = max(own, key=lambda pair: pair.num_shared, default=None)
    if best is None or best.num_shared < _MIN_SHARED_FOR_OFFSET:
        shared = 0 if best is None else best.num_shared
        message = f"The camera shares {shared} views of the board with another camera; too few to link it."
        hint = "Film the board where this camera and a neighbour both see it, and hold it still there."
        return Problem(BOARD_UNLINKED, message, camera=name, hint=hint)
    other = rig.views[best.second if best.first == number else best.first].camera
    message = (
        f"The camera and {other} disagree: of {best.num_shared} views at the same time, {best.num_agreeing} give the "
        "same relative pose."
    )
    offset_s = _offset_s(rig, number, best.second if best.first == number else best.first, frame_rate_hz)
    hint = "Check that the videos are synchronised and that no camera moved."
    if offset_s is not None:
        hint = f"The clocks seem to differ: with an offset of {offset_s:+.3f} s for {name} the views agree."
    return Problem(BOARD_UNSYNCHRONISED, message, camera=name, hint=hint)


def _offset_s(rig: BoardRig, number: int, other: int, frame_rate_hz: float) -> float | None:
    """Offset of a camera with which its views agree with another camera's; ``None`` if none is found."""
    if frame_rate_hz <= 0:
        return None
    most, best_s = 0.0, None
    for frames in range(-int(_MAX_OFFSET_S * frame_rate_hz), int(_MAX_OFFSET_S * frame_rate_hz) + 1):
        offset_s = frames / frame_rate_hz
        times = [rig.views[number].time_s + offset_s, rig.views[other].time_s]
        both = match_times(times, 0.5 / frame_rate_hz)
        both = both[(both >= 0).all(1)]
        if len(both) < _MIN_SHARED_FOR_OFFSET:
            continue
        chosen = both[np.unique(np.linspace(0, len(both) - 1, 40).astype(int))]
        pair = relate_by_board(0, 1, [(rig.poses[number][a], rig.poses[other][b]) for a, b in chosen])
        share = 0.0 if pair is None else pair.num_agreeing / pair.num_shared
        if share > _CERTAIN_SHARE and share * len(both) > most:
            most, best_s = share * len(both), offset_s
    return best_s


def view_warnings(views: Sequence[BoardViews]) -> Iterator[Problem]:
    """Cameras whose views are few, cover little of the picture, or are partly mirrored."""
    for camera_views in views:
        if len(camera_views) < _FEW_VIEWS:
            message = f"The board was found in {len(camera_views)} of {camera_views.num_pictures} pictures."
            hint = "Film it longer, at several distances and tilts."
            yield Problem(finding_codes.BOARD_FEW_VIEWS, message, camera=camera_views.camera, hint=hint)
        if (share := covered_share(camera_views)) < _POOR_COVERAGE:
            message = f"The board covers {share:.0%} of the picture."
            hint = "Film it near the edges and the corners of the picture too, as the coverage picture shows."
            yield Problem(finding_codes.BOARD_POOR_COVERAGE, message, camera=camera_views.camera, hint=hint)
        if camera_views.num_mirrored:
            message = f"The board is mirrored in {camera_views.num_mirrored} pictures."
            hint = "Turn off the mirroring of the camera: its videos would be mirrored too."
            yield Problem(finding_codes.BOARD_MIRRORED, message, camera=camera_views.camera, hint=hint)


def link_warnings(views: Sequence[BoardViews], pairs: Sequence[BoardPair]) -> Iterator[Problem]:
    """Doubts about the links between cameras."""
    for number, camera_views in enumerate(views):
        most = max((pair.num_agreeing for pair in pairs if number in (pair.first, pair.second)), default=0)
        if most < _FEW_SHARED:
            message = f"The camera is linked by {most} views of the board that another camera shares."
            hint = "Film the board where this camera and a neighbour both see it."
            yield Problem(finding_codes.BOARD_FEW_SHARED, message, camera=camera_views.camera, hint=hint)


def require_placed(rig: BoardRig, placed: Sequence[PlacedBoard]) -> None:
    """Raise ``InputError`` with all cameras of which too few views fit the views of other cameras."""
    problems = []
    for number, views in enumerate(rig.views):
        num_shared = int(((rig.instants[:, number] >= 0) & ((rig.instants >= 0).sum(1) > 1)).sum())
        num_fitting = sum(number in board.corners_px and len(board.corners_px) > 1 for board in placed)
        if num_fitting < _MIN_AGREEING:
            message = (
                f"Of {num_shared} views of the board that the camera shares with another camera, {num_fitting} fit "
                f"together; at least {_MIN_AGREEING} are required."
            )
            hint = "Film the board where this camera and a neighbour both see it, and hold it still there."
            problems.append(Problem(BOARD_UNLINKED, message, camera=views.camera, hint=hint))
    if problems:
        raise InputError(problems)


def agreement_warnings(views: Sequence[BoardViews], fitted: BoardFit) -> Iterator[Problem]:
    """Cameras that see the board at poses that differ by much more than their own errors, with the likely cause."""
    adjustment = fitted.adjustment
    joint_px, own_px = adjustment.error_px(fitted.owner), adjustment.error_px(fitted.owner, is_own=True)
    is_far = (joint_px > _FAR_ABOVE * own_px) & (joint_px > own_px + _FAR_ABOVE_PX)
    if adjustment.deviations is None or not is_far.any():
        return
    is_late = np.abs(adjustment.deviations.delay_s) >= _LATE_S
    is_late &= fitted.late_share() >= _LATE_SHARE
    # A camera that is late disturbs the errors of the others.
    for number in np.flatnonzero(is_late if is_late.any() else is_far).tolist():
        name, delay_s = views[number].camera, adjustment.deviations.delay_s[number]
        message = (
            f"The camera sees the board {1000 * fitted.apart_m(number):.1f} mm from where the others see it; the error "
            f"is {own_px[number]:.2f} px by itself and {joint_px[number]:.2f} px together with them."
        )
        if is_late[number]:
            order = "after" if delay_s < 0 else "before"
            message += f" Its pictures come {1000 * abs(delay_s):.0f} ms {order} the others'."
            hint = (
                f"Start all cameras by one trigger, or state the offset of {name} ({delay_s:+.3f} s, added to a stated "
                "one) here and when you reconstruct."
            )
        elif fitted.moving_ratio(number) > _MOVING:
            hint = (
                "The difference grows with the speed of the board: the cameras are not synchronous, or their shutters "
                "roll. Hold the board still in each place, or synchronise the cameras."
            )
        else:
            hint = (
                "The difference is there while the board hardly moves: look for a board that is bent, a stated size or "
                "intrinsics that are wrong, or a camera that moved."
            )
        yield Problem(finding_codes.BOARD_DISAGREES, message, camera=name, hint=hint)


def floor_warnings(places: Places, time_s: float, board: Board) -> Iterator[Problem]:
    """Doubts about the floor, on which the board lies at a time, and about the direction of its axes."""
    if board.is_ambiguous:
        message = (
            f"A chessboard of {board.cols} x {board.rows} corners looks the same upside down: the origin and the "
            "directions of x and y may belong to the opposite corner."
        )
        hint = "Use a board with an odd and an even number, a ChArUco board, or known points."
        yield Problem(finding_codes.BOARD_AMBIGUOUS, message, hint=hint)
    if not places.is_certain:
        message = f"The board never lies still on the floor; the floor is taken as the board is at {time_s:.2f} s."
        hint = "Lay the board flat on the floor for a second, or state the time at which it lies there."
        yield Problem(finding_codes.BOARD_FLOOR_UNCERTAIN, message, hint=hint)
