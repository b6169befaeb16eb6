"""A white-on-black board that four webcams filmed, against another tool's result."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from rich.progress import Progress

from api.cli.commands.calibrate import in_videos
from api.cli.sources import SourceOptions
from pipeline.calibration.board.calibrate_board import calibrate_board
from pipeline.calibration.board.intrinsics import calibrate_intrinsics
from pipeline.calibration.board.spec import parse_board
from pipeline.geometry.camera import center_in_world
from tests.e2e.datasets import folder_of, needs

BOARD = parse_board("charuco:4x5:0.054:0.0405:DICT_4X4_1000")


def stored_centers_m(file: Path) -> np.ndarray:
    cameras = tomllib.loads(file.read_text())["cameras"]
    return np.array([-np.transpose(one["rotation"]) @ one["translation"] for _, one in sorted(cameras.items())])


def moved_onto(points_m: np.ndarray, onto_m: np.ndarray) -> np.ndarray:
    """Points after the rigid motion that brings them closest to others."""
    left, _, right = np.linalg.svd((points_m - points_m.mean(0)).T @ (onto_m - onto_m.mean(0)))
    turn = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    return (points_m - points_m.mean(0)) @ turn + onto_m.mean(0)


@pytest.mark.slow
@needs("boards")
def test_board_on_webcams_gives_lenses_and_names_late_camera() -> None:
    folder = folder_of("boards")
    session = SourceOptions([folder]).open_videos(None, keeps_poses=False)
    with Progress(disable=True) as progress:
        views = list(in_videos(session, BOARD, progress))
    assert [len(of_camera) > 35 for of_camera in views] == [True] * 4
    made = calibrate_board(views, BOARD, None, session.timebase.frame_rate_hz)
    assert [camera.name for camera in made.cameras] == ["cam_0", "cam_1", "cam_2", "cam_3"]
    for camera, own in zip(made.cameras, views, strict=True):
        own_px = calibrate_intrinsics(own, BOARD).camera.matrix[0, 0]
        assert abs(camera.matrix[0, 0] / own_px - 1) < 0.01
    # The tool knows no delays, and one camera is late: its own result is as far from the truth.
    centers_m = np.array([center_in_world(camera) for camera in made.cameras])
    stored_m = stored_centers_m(folder / "camera_array.toml")
    assert np.linalg.norm(moved_onto(centers_m, stored_m) - stored_m, axis=1).max() < 0.016
    late = [warning for warning in made.warnings if warning.code == "board_disagrees" and "ms after" in warning.message]
    assert [warning.camera for warning in late] == ["cam_1"]
