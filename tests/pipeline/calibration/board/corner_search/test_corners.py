"""Alignment of corners: accuracy, corners that a detector missed, hidden corners."""

import cv2
import numpy as np
import pytest

from pipeline.calibration.board.corner_search.corners import align_corners
from pipeline.calibration.board.spec import Board, parse_board
from pipeline.geometry.camera import project
from tests.pipeline.calibration.board.conftest import ring
from tests.pipeline.calibration.board.filmed_boards import BoardPainter, board_poses

CAMERA = ring(4)[0]
EDGE_PX = 1.9


def on_the_floor(spec: str, seed: int) -> tuple[Board, np.ndarray, np.ndarray]:
    """Board, its picture as it lies on the floor, and the true corners."""
    board, rng = parse_board(spec), np.random.default_rng(seed)
    _, (pose, *_) = board_poses([CAMERA], board, 1, rng)
    picture = cv2.cvtColor(BoardPainter(CAMERA, board).paint(pose, rng), cv2.COLOR_RGB2GRAY)
    return board, picture, project(CAMERA, pose.apply(board.corners_m))


@pytest.mark.parametrize("spec", ["charuco:7x5:0.12:0.09:DICT_4X4_50", "chessboard:6x5:0.1"])
def test_corners_of_small_squares_are_exact_to_0_01_px(spec: str) -> None:
    board, picture, truth_px = on_the_floor(spec, 1)
    rng = np.random.default_rng(2)
    given_px = truth_px + rng.uniform(-1.2, 1.2, truth_px.shape)
    given_px[rng.permutation(board.num_corners)[: board.num_corners // 2]] = np.nan
    distance_px = np.linalg.norm(align_corners(picture, given_px, board, EDGE_PX) - truth_px, axis=-1)
    assert np.isfinite(distance_px).all()
    assert np.median(distance_px) < 0.02
    assert distance_px.max() < 0.08


def test_hidden_corners_are_not_found() -> None:
    board, picture, truth_px = on_the_floor("charuco:7x5:0.12:0.09:DICT_4X4_50", 3)
    hidden = np.isin(np.arange(board.num_corners), (0, 1, 6, 7))
    low, high = truth_px[hidden].min(0).astype(int) - 3, truth_px[hidden].max(0).astype(int) + 4
    picture[low[1] : high[1], low[0] : high[0]] = np.random.default_rng(4).integers(60, 200, (*(high - low)[::-1],))
    found = np.isfinite(align_corners(picture, truth_px, board, EDGE_PX)).all(-1)
    assert not found[hidden].any()
    assert found[[4, 5, 10, 11, 16, 17, 22, 23]].all()
    assert not np.isfinite(align_corners(np.full_like(picture, 128), truth_px, board, EDGE_PX)).any()
