"""Poses of boards in cameras of both lens models."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.calibration.board.poses import possible_poses
from pipeline.calibration.board.spec import Board
from pipeline.core.data.cameras import Camera, LensModel
from pipeline.geometry.camera import look_at, project
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras

BOARD = Board("charuco", 7, 5, 0.08, 0.06, "DICT_4X4_50")
DISTORTION: dict[LensModel, tuple[float, ...]] = {
    "standard": (-0.1, 0.03, 5e-4, -4e-4, 0.0),
    "fisheye": (0.035, -0.011, 0.002, -5e-4),
}


def camera_of(lens: LensModel) -> Camera:
    rig = Rig(Layout.RING, 1, (3.0, 2.5), 2.0, focal_px=400.0, distortion=DISTORTION[lens], lens=lens)
    return build_cameras(rig, np.random.default_rng(0))[0]


@pytest.mark.parametrize("lens", DISTORTION)
def test_best_pose_is_true_one(lens: LensModel) -> None:
    camera = camera_of(lens)
    board_from_away = look_at(np.array([0.3, -0.7, 0.5]), np.array([0.05, 0.1, 0.0]))
    corners_px = project(replace(camera, cam_from_world=board_from_away), BOARD.corners_m)
    assert np.isfinite(corners_px).all()
    best = possible_poses(camera, corners_px, BOARD)[0]
    np.testing.assert_allclose(best.rotation, board_from_away.rotation, atol=1e-4)
    np.testing.assert_allclose(best.translation_m, board_from_away.translation_m, atol=1e-4)


def test_board_beyond_fisheyes_view_has_no_pose() -> None:
    assert possible_poses(camera_of("fisheye"), np.full((BOARD.num_corners, 2), 1e5), BOARD) == []
