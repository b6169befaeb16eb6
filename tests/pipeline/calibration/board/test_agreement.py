"""Cameras that disagree about a board that moves: delays, lenses, standard deviations, refusals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.calibration.board.board_checks import require_placed
from pipeline.calibration.board.board_rig import BoardRig
from pipeline.calibration.board.calibrate_board import calibrate_board
from pipeline.calibration.board.spec import parse_board
from pipeline.calibration.board.views import BoardViews
from pipeline.calibration.report import CalibrationResult
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.core.errors import InputError
from pipeline.geometry.camera import center_in_world
from tests.cases import accuracy_but
from tests.pipeline.calibration.board.conftest import ring, views_of

BOARD = parse_board("charuco:7x5:0.1:0.075:DICT_4X4_50")
CAMERAS = ring(4)
TIMES_S = np.arange(0.0, 30.0, 0.25)


def carried(time_s: float, waves: np.ndarray) -> Rigid3:
    """Board that is carried and turned about the middle of the ring, at about 0.4 m/s; ``waves``: rate and phase."""
    sizes = np.array([0.35, 0.35, 0.2, 0.45, 0.45, 0.5])
    shift = (sizes[:, None] * np.sin(2 * np.pi * waves[0] * time_s + waves[1])).sum(1)
    angle = 2 * np.pi * time_s / 40.0
    away = -np.array([np.cos(angle), np.sin(angle), 0.35]) / np.hypot(1.0, 0.35)
    down = np.array([0.0, 0.0, -1.0]) + away * away[2]
    down /= np.linalg.norm(down)
    facing = np.column_stack([np.cross(down, away), down, away])
    rotation = facing @ Rotation.from_rotvec(shift[3:]).as_matrix()
    return Rigid3(rotation, np.array([0.0, 0.0, 1.0]) + shift[:3] - rotation @ BOARD.corners_m.mean(0))


def filmed(seed: int, delays_s: tuple[float, ...] = (0.0,) * 4) -> list[BoardViews]:
    """Views of the carried board by cameras whose pictures are of later moments than their times say."""
    rng = np.random.default_rng(seed)
    waves = np.array([rng.uniform(0.03, 0.18, (6, 4)), rng.uniform(0.0, 2 * np.pi, (6, 4))])
    views = []
    for camera, delay_s in zip(CAMERAS, delays_s, strict=True):
        poses = [carried(time_s + delay_s, waves) for time_s in TIMES_S]
        views += views_of([camera], BOARD, TIMES_S, poses, rng, 0.15)
    return views


def scores(made: CalibrationResult, cameras: tuple[Camera, ...]) -> np.ndarray:
    """Errors of places and rotations, relative to the camera at the origin, and of focal lengths, in deviations."""
    root = int(np.argmin([report.position_sigma_mm for report in made.by_camera]))
    found = []
    for number, (camera, truth, report) in enumerate(zip(made.cameras, cameras, made.by_camera, strict=True)):
        found.append(100 * abs(camera.matrix[0, 0] / truth.matrix[0, 0] - 1) / report.focal_sigma_percent)
        if number != root:
            places_m = [
                some[root].cam_from_world.apply(center_in_world(some[number])) for some in (made.cameras, cameras)
            ]
            turns = [
                (some[number].cam_from_world @ some[root].cam_from_world.inverse()).rotation
                for some in (made.cameras, cameras)
            ]
            turn_deg = np.degrees(Rotation.from_matrix(turns[0] @ turns[1].T).magnitude())
            found.append(1000 * np.linalg.norm(places_m[0] - places_m[1]) / report.position_sigma_mm)
            found.append(turn_deg / report.rotation_sigma_deg)
    return np.array(found)


@pytest.mark.slow
def test_late_camera_is_named_and_bends_no_lens() -> None:
    made = calibrate_board(filmed(0, (0.0, 0.0, -0.04, 0.0)), BOARD, None, 4.0)
    for found, truth in zip(made.cameras, CAMERAS, strict=True):
        assert abs(found.matrix[0, 0] / truth.matrix[0, 0] - 1) < 0.003
    (doubt,) = [warning for warning in made.warnings if warning.code == "board_disagrees"]
    assert doubt.camera == CAMERAS[2].name
    assert "40 ms after" in doubt.message
    assert "-0.040 s" in (doubt.hint or "")
    assert not np.isnan([report.reprojection_error_px for report in made.by_camera]).any()


@pytest.mark.slow
def test_cameras_that_agree_give_no_doubt() -> None:
    made = calibrate_board(filmed(1), BOARD, None, 4.0)
    assert "board_disagrees" not in {warning.code for warning in made.warnings}
    assert made.reprojection_error_px < 0.3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seeds", "seeds_of_late"),
    accuracy_but([(range(1), range(9, 10))], [(range(1), range(9, 10)), (range(8), range(8, 16))]),
)
def test_errors_are_within_standard_deviations(seeds: range, seeds_of_late: range) -> None:
    late = (0.0, 0.01, -0.03, 0.0)
    found = [scores(calibrate_board(filmed(seed), BOARD, None, 4.0), CAMERAS) for seed in seeds]
    found += [scores(calibrate_board(filmed(seed, late), BOARD, None, 4.0), CAMERAS) for seed in seeds_of_late]
    assert (np.concatenate(found) < 2.0).mean() >= 0.95


def test_few_common_views_are_refused_with_their_number() -> None:
    views = filmed(2)
    instants = np.full((4, 4), -1)
    instants[:, :2] = np.arange(4)[:, None]
    rig = BoardRig(tuple(views), CAMERAS, ((),) * 4, instants)
    with pytest.raises(InputError) as raised:
        require_placed(rig, [])
    assert [(problem.code, problem.camera) for problem in raised.value.problems] == [
        ("board_unlinked", camera.name) for camera in CAMERAS
    ]
    assert "Of 4 views" in str(raised.value)


def test_board_seen_by_one_camera_is_refused() -> None:
    views = filmed(3)
    with pytest.raises(InputError) as raised:
        calibrate_board([of_camera.select([0]) for of_camera in views], BOARD, None, 4.0)
    assert {problem.code for problem in raised.value.problems} == {"board_not_found"}
    given = {camera.name: camera for camera in CAMERAS}
    with pytest.raises(InputError) as raised:
        calibrate_board([of_camera.select([0]) for of_camera in views], BOARD, given, 4.0)
    assert {problem.code for problem in raised.value.problems} == {"board_unlinked"}
    apart = [replace(one, time_s=read_only(one.time_s + 100.0 * number)) for number, one in enumerate(views)]
    with pytest.raises(InputError) as raised:
        calibrate_board(apart, BOARD, given, 4.0)
    assert {problem.code for problem in raised.value.problems} == {"board_unlinked"}
