"""Boards as they are printed and filmed: white on black, with the markers of OpenCV before 4.6, sharpened."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.calibration.board.corner_search.find_board import DetectedBoard, find_board, is_exchanged
from pipeline.calibration.board.source import look_in_photographs
from pipeline.calibration.board.spec import Board, parse_board
from pipeline.core.data.rigid import Rigid3
from pipeline.geometry.camera import project
from tests.pipeline.calibration.board.conftest import ring
from tests.pipeline.calibration.board.filmed_boards import BoardPainter, board_poses

CAMERA = ring(4)[0]
CHARUCO, EVEN_ROWS = "charuco:7x5:0.12:0.09:DICT_4X4_50", "charuco:5x6:0.12:0.09:DICT_4X4_50"


def pose_of(board: Board) -> Rigid3:
    _, poses = board_poses([CAMERA], board, 1, np.random.default_rng(3))
    return poses[-1]


def painted(board: Board) -> np.ndarray:
    return BoardPainter(CAMERA, board).paint(pose_of(board), np.random.default_rng(4))


@pytest.mark.parametrize(
    ("spec", "is_inverted", "is_legacy"),
    [
        (CHARUCO, False, False),
        (CHARUCO, True, False),
        (EVEN_ROWS, False, True),
        (EVEN_ROWS, True, True),
        ("chessboard:7x5:0.1", False, False),
        ("chessboard:7x5:0.1", True, False),
        ("chessboard:8x6:0.1", True, False),
    ],
)
def test_board_is_found_however_it_is_printed(spec: str, is_inverted: bool, is_legacy: bool) -> None:
    stated = parse_board(spec)
    board = replace(stated, is_inverted=is_inverted, is_legacy=is_legacy)
    found = find_board(painted(board), *stated.prints)
    assert found is not None
    assert not found.is_mirrored
    assert found.board == board
    truth_px = project(CAMERA, pose_of(board).apply(board.corners_m))
    numberings = (truth_px, truth_px[::-1]) if board.is_ambiguous else (truth_px,)
    error_px = min(np.nanmax(np.linalg.norm(found.corners_px - numbered, axis=-1)) for numbered in numberings)
    assert error_px < 0.1
    assert np.isfinite(found.corners_px).all()
    assert found.is_sure


@pytest.mark.parametrize("spec", ["chessboard:9x6:0.1", "chessboard:7x7:0.1"])
def test_negative_of_these_chessboards_is_board_turned(spec: str) -> None:
    board = parse_board(spec)
    assert board.prints == (board,)
    for printed in (board, replace(board, is_inverted=True)):
        found = find_board(painted(printed), board)
        assert found is not None
        grid_px = project(CAMERA, pose_of(board).apply(board.corners_m)).reshape(board.rows, board.cols, 2)
        turns = [turns for turns in range(4) if board.cols == board.rows or turns % 2 == 0]
        errors_px = [
            np.linalg.norm(found.corners_px - np.rot90(grid_px, turn).reshape(-1, 2), axis=-1).max() for turn in turns
        ]
        assert min(errors_px) < 0.1
        # The first corner has a black square behind it, however the board is printed.
        first = turns[int(np.argmin(errors_px))]
        assert first in ((1, 2, 3) if printed.is_inverted else (0, 2))


def test_board_with_exchanged_rows_and_columns_is_noticed() -> None:
    board = replace(parse_board(CHARUCO), is_inverted=True)
    assert is_exchanged(painted(board), parse_board(CHARUCO).exchanged)
    assert not is_exchanged(painted(board), parse_board(CHARUCO))


def test_camera_that_sharpens_gives_all_corners() -> None:
    board = parse_board("charuco:7x5:0.12:0.09:DICT_4X4_50")
    picture = painted(board).astype(np.float32)
    blurred = cv2.GaussianBlur(picture, (0, 0), 1.5)
    sharpened = np.clip(np.round(picture + 2.5 * (picture - blurred)), 0, 255).astype(np.uint8)
    found = find_board(sharpened, board)
    assert found is not None
    distance_px = np.linalg.norm(found.corners_px - project(CAMERA, pose_of(board).apply(board.corners_m)), axis=-1)
    assert np.isfinite(distance_px).all()
    assert distance_px.max() < 0.25


def test_print_is_tried_until_it_is_known(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stated = parse_board(EVEN_ROWS)
    picture = painted(replace(stated, is_inverted=True))
    empty = np.full_like(picture, 128)
    paths = []
    for number, image in enumerate([empty, picture, empty, picture]):
        paths.append(tmp_path / f"{number}.png")
        cv2.imwrite(str(paths[-1]), image)
    tried: list[tuple[Board, ...]] = []

    def spy(image: np.ndarray, *boards: Board) -> DetectedBoard | None:
        tried.append(boards)
        return find_board(image, *boards)

    monkeypatch.setattr("pipeline.calibration.board.source.find_board", spy)
    views = look_in_photographs("cam_1", paths, stated)
    assert (len(views), views.num_pictures) == (2, 4)
    inverted = (replace(stated, is_inverted=True),)
    assert tried == [stated.prints, stated.prints, inverted, inverted]


def test_part_that_two_prints_share_does_not_tell_them_apart(tmp_path: Path) -> None:
    stated = parse_board(EVEN_ROWS)
    for is_legacy in (False, True):
        board = replace(stated, is_legacy=is_legacy)
        whole = painted(board)
        truth_px = project(CAMERA, pose_of(board).apply(board.corners_m)).reshape(5, 4, 2)
        # Cover the column by which the two prints differ: the last one of the older print, the first one of the newer.
        hidden = whole.copy()
        column, beyond = (
            (3, 2 * truth_px[:, 3] - truth_px[:, 2]) if is_legacy else (0, 2 * truth_px[:, 0] - truth_px[:, 1])
        )
        middle_px = truth_px[:, column] + 0.12 * (truth_px[:, 1 if is_legacy else 2] - truth_px[:, column])
        outline = np.concatenate([middle_px, beyond[::-1]])
        outline += 1.6 * (outline - outline.mean(0)) * [0.0, 1.0]
        cv2.fillPoly(hidden, [outline.round().astype(np.int32)], (128, 128, 128))
        part = find_board(hidden, *stated.prints)
        assert part is not None
        assert (part.is_sure, part.board.is_legacy) == (False, False)
        paths = []
        for number, image in enumerate([hidden, whole]):
            paths.append(tmp_path / f"{is_legacy}_{number}.png")
            cv2.imwrite(str(paths[-1]), image)
        # The part is one of the views only if it was numbered as the whole is.
        views = look_in_photographs("cam_1", paths, stated)
        assert len(views) == (1 if is_legacy else 2)
        assert np.isfinite(views.corners_px[-1]).all()
