"""Modules of the view Record and of phones without a browser: Node runs the tests in this folder."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.api.portal.node import run_by_node

SQUARE_PX = 160


@pytest.mark.parametrize("module", ["clock", "journal", "names", "words"])
def test_modules_of_recordings(module: str, tmp_path: Path) -> None:
    run_by_node(Path(__file__).with_name(f"{module}.test.mjs"), tmp_path)


def test_board_equals_opencv_board(tmp_path: Path) -> None:
    run_by_node(Path(__file__).with_name("board.test.mjs"), tmp_path)
    board = json.loads((tmp_path / "board.json").read_bytes())
    size = (board["cols"], board["rows"])
    drawn = np.full((size[1] * SQUARE_PX, size[0] * SQUARE_PX), 255, np.uint8)
    for x, y, width, height in board["parts"]:
        left, top, right, bottom = (round(value * SQUARE_PX) for value in (x, y, x + width, y + height))
        drawn[top:bottom, left:right] = 0
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    expected = cv2.aruco.CharucoBoard(size, 1.0, 0.75, dictionary).generateImage(drawn.shape[::-1])
    np.testing.assert_array_equal(drawn, expected)
