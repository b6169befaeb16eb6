"""Boards in pictures too blurred and noisy for single markers: corners by squares, numbered by all markers together."""

from collections.abc import Iterator

import cv2
import numpy as np
import pytest

from pipeline.calibration.board.corner_search.find_board import find_board
from pipeline.calibration.board.corner_search.numbering import number_corners
from pipeline.calibration.board.corner_search.squares import find_grids
from pipeline.calibration.board.spec import parse_board
from pipeline.geometry.camera import center_in_world, project
from tests.pipeline.calibration.board.conftest import ring
from tests.pipeline.calibration.board.filmed_boards import BoardPainter, board_poses

BOARD = parse_board("charuco:7x5:0.12:0.09:DICT_4X4_50")
CAMERA = ring(4)[0]


def blurred(count: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Pictures of the whole board, at least 25 degrees from edge-on, with the true corners."""
    rng = np.random.default_rng(301)
    painter = BoardPainter(CAMERA, BOARD, 1.3, 8.0)
    _, poses = board_poses([CAMERA], BOARD, 40, rng)
    for pose in poses[::2]:
        towards = center_in_world(CAMERA) - pose.translation_m
        truth_px = project(CAMERA, pose.apply(BOARD.corners_m))
        is_inside = ((truth_px > 20) & (truth_px < np.array(CAMERA.size_px) - 20)).all()
        if is_inside and -pose.rotation[:, 2] @ towards > np.sin(np.deg2rad(25)) * np.linalg.norm(towards):
            yield painter.paint(pose, rng), truth_px
            count -= 1
        if count == 0:
            return


@pytest.fixture(scope="module")
def pictures() -> list[tuple[np.ndarray, np.ndarray]]:
    return list(blurred(6))


@pytest.mark.slow
def test_blurred_boards_are_found_with_right_numbers(pictures: list[tuple[np.ndarray, np.ndarray]]) -> None:
    assert len(pictures) == 6
    num_found = 0
    for picture, truth_px in pictures:
        if (found := find_board(picture, BOARD)) is None:
            continue
        assert not found.is_mirrored
        distance_px = np.linalg.norm(found.corners_px - truth_px, axis=-1)
        assert np.isfinite(distance_px).sum() >= 6
        assert np.nanmax(distance_px) < 1.0
        num_found += 1
    # Markers that are read one by one give 3 of these boards.
    assert num_found >= 5


def test_grid_of_another_board_is_not_numbered(pictures: list[tuple[np.ndarray, np.ndarray]]) -> None:
    exchanged = parse_board("charuco:5x7:0.12:0.09:DICT_4X4_50")
    numbered = 0
    for picture, _ in pictures[:3]:
        gray = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
        mirrored = np.ascontiguousarray(gray[:, ::-1])
        for grid in find_grids(gray):
            numbered += number_corners(gray, grid, BOARD) is not None
            assert number_corners(gray, grid, exchanged) is None
        assert all(number_corners(mirrored, grid, BOARD) is None for grid in find_grids(mirrored))
    assert numbered > 0


def test_noise_has_no_board() -> None:
    rng = np.random.default_rng(5)
    noise = cv2.GaussianBlur(rng.integers(0, 256, (480, 640, 3), dtype=np.uint8), (0, 0), 2.0)
    assert find_board(noise, BOARD) is None
    assert list(find_grids(np.full((480, 640), 128, np.uint8))) == []
