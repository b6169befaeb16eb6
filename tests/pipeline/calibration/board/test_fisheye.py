"""Intrinsics of fisheye lenses from a board."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.calibration.board.intrinsics import calibrate_intrinsics
from pipeline.calibration.board.spec import parse_board
from pipeline.calibration.sizes import guessed_camera
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, LensModel
from pipeline.core.data.rigid import Rigid3
from tests.pipeline.calibration.board.conftest import views_of

BOARD = parse_board("charuco:7x5:0.05:0.0375:DICT_4X4_50")


def camera_of(focal_share: float, distortion: list[float], lens: LensModel) -> Camera:
    guess = guessed_camera("cam", (1280, 960))
    matrix = guess.matrix.copy()
    matrix[[0, 1], [0, 1]] = focal_share * 1280
    return replace(guess, matrix=read_only(matrix), distortion=read_only(np.array(distortion)), lens=lens)


def poses_around(rng: np.random.Generator, num_poses: int, most_deg: float) -> list[Rigid3]:
    """Board that faces the camera in all directions up to an angle from the axis, 0.3 to 0.8 m away, tilted."""
    found = []
    for _ in range(num_poses):
        angle, around = np.radians(most_deg) * np.sqrt(rng.random()), 2 * np.pi * rng.random()
        towards = Rotation.from_rotvec(angle * np.array([np.cos(around), np.sin(around), 0.0]))
        rotation = (towards * Rotation.from_euler("xyz", rng.uniform(-0.6, 0.6, 3))).as_matrix()
        middle_m = towards.as_matrix() @ [0.0, 0.0, rng.uniform(0.3, 0.8)]
        found.append(Rigid3(rotation, middle_m - rotation @ BOARD.corners_m.mean(0)))
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("truth", "lens"),
    [
        (camera_of(0.3, [0.02, -0.008, 0.003, -0.001], "fisheye"), "fisheye"),
        (camera_of(0.42, [-0.04, 0.004, 0.0, 0.0], "fisheye"), "fisheye"),
        # Wide, but none of a fisheye.
        (camera_of(0.5, [-0.2, 0.03, 0.001, -0.0005], "standard"), "standard"),
    ],
)
def test_lens_model_is_one_that_made_pictures(truth: Camera, lens: LensModel) -> None:
    rng = np.random.default_rng(11)
    poses = poses_around(rng, 60, 65.0 if lens == "fisheye" else 40.0)
    (views,) = views_of([truth], BOARD, np.arange(60.0), poses, rng)
    found = calibrate_intrinsics(views, BOARD)
    assert found.camera.lens == lens
    assert abs(found.camera.matrix[0, 0] / truth.matrix[0, 0] - 1) < 0.003
    np.testing.assert_allclose(found.camera.matrix[:2, 2], truth.matrix[:2, 2], atol=1.0)
    assert found.error_px < 0.35
    assert 0 < found.focal_sigma < 0.003
