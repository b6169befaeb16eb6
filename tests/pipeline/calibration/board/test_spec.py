"""Specifications of boards."""

import numpy as np
import pytest

from pipeline.calibration.board.spec import Board, parse_board
from pipeline.core.errors import InputError


def test_chessboard_has_inner_corners() -> None:
    board = parse_board("chessboard:4x7:0.06")
    assert board == Board("chessboard", 4, 7, 0.06)
    assert board.num_corners == 28
    np.testing.assert_allclose(board.corners_m[[0, 3, 4]], [[0.0, 0.0, 0.0], [0.18, 0.0, 0.0], [0.0, 0.06, 0.0]])


def test_charuco_board_has_squares() -> None:
    board = parse_board("charuco:7x5:0.06:0.045:DICT_4X4_50")
    assert board.corner_counts == (6, 4)
    np.testing.assert_allclose(board.corners_m, board.charuco.getChessboardCorners(), atol=1e-7)
    assert str(board) == "charuco:7x5:0.06:0.045:DICT_4X4_50"


@pytest.mark.parametrize(("spec", "is_ambiguous"), [("4x7", False), ("7x4", False), ("7x5", True), ("8x6", True)])
def test_boards_that_look_alike_after_half_turn(spec: str, is_ambiguous: bool) -> None:
    assert parse_board(f"chessboard:{spec}:0.05").is_ambiguous is is_ambiguous


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("paper", "chessboard:COLSxROWS:SQUARE_M"),
        ("chessboard:9x6:60", "State metres: 0.06."),
        ("chessboard:1x6:0.06", "inner corners, at least 2"),
        ("chessboard:9x6:0.06:0.04:DICT_4X4_50", "has no markers"),
        ("charuco:7x5:0.06", "needs the side of a marker"),
        ("charuco:7x5:0.06:0.06:DICT_4X4_50", "smaller than a square"),
        ("charuco:7x5:0.06:0.04:DICT_9X9", "There is no dictionary DICT_9X9."),
        ("charuco:20x20:0.06:0.04:DICT_4X4_50", "The board has 200 markers, the dictionary DICT_4X4_50 has 50."),
        ("charuco:7x5:e:0.04:DICT_4X4_50", "not from"),
    ],
)
def test_wrong_board_says_how_to_write_it(spec: str, words: str) -> None:
    with pytest.raises(InputError) as raised:
        parse_board(spec)
    assert words in str(raised.value)
    assert {problem.code for problem in raised.value.problems} == {"board_invalid"}
