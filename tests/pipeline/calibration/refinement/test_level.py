"""Levelling of a tilted or lifted world from the feet of people, and worlds that are left alone."""

from dataclasses import replace

import numpy as np
import pytest
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.calibration.refinement.level import Level, find_level
from pipeline.calibration.similarity import move_world
from pipeline.core.data.cameras import Camera
from pipeline.core.data.people import Poses3D
from pipeline.core.data.rigid import Rigid3
from pipeline.core.joints import JointSet
from pipeline.geometry.camera import project
from tests.pipeline.calibration.refinement.people import ring

JOINTS = JointSet(("left_shoulder", "right_shoulder", "left_ankle", "right_ankle"), ())
CAMERAS = ring(4)
TILTED = Rigid3(Rotation.from_rotvec(np.radians([5.0, -3.0, 0.0])).as_matrix(), np.array([0.0, 0.0, 0.4]))
Bodies = Float[np.ndarray, "poses 4 3"]


def walkers(reach_m: float = 1.5, num: int = 200, lean_deg: float = 0.0) -> Bodies:
    """People at places on the floor who lift one foot."""
    rng = np.random.default_rng(0)
    place_m = np.column_stack([rng.uniform(-reach_m, reach_m, (num, 2)), np.zeros(num)])
    body_m = np.array([[0.2, 0.0, 1.42], [-0.2, 0.0, 1.42], [0.1, 0.0, 0.065], [-0.1, 0.0, 0.065]])
    leaning = body_m @ Rotation.from_euler("x", lean_deg, degrees=True).as_matrix().T
    points_m = place_m[:, None] + leaning + rng.normal(0.0, 0.008, (num, 4, 3))
    points_m[np.arange(num), 2 + np.arange(num) % 2, 2] += 0.12
    return points_m


def seen(cameras: tuple[Camera, ...], points_m: Bodies) -> list[Poses3D]:
    points_px = np.stack([project(camera, points_m) for camera in cameras], axis=2)
    score = np.where(np.isfinite(points_px[..., 0]), 0.9, 0.0)
    return [Poses3D(np.arange(len(points_m)), points_m, points_px, score)]


def in_world(world_from_true: Rigid3) -> tuple[Camera, ...]:
    inverse = world_from_true.inverse()
    return tuple(replace(camera, cam_from_world=camera.cam_from_world @ inverse) for camera in CAMERAS)


def found(given_from_true: Rigid3, points_m: Bodies) -> Level | None:
    """Level of a world in which the cameras are given; the pictures are those of the true one."""
    return find_level(in_world(given_from_true), seen(CAMERAS, points_m), JOINTS)


def test_tilted_world_is_levelled_and_people_keep_their_place() -> None:
    level = found(TILTED, walkers())
    assert level is not None
    assert level.tilt_deg == pytest.approx(np.hypot(5.0, 3.0), abs=0.2)
    assert level.height_m == pytest.approx(0.4, abs=0.02)
    level_from_true = level.level_from_given @ TILTED
    assert np.degrees(np.arccos(level_from_true.rotation[2, 2])) < 0.2
    floor_m = level_from_true.apply(np.array([[1.5, 1.5, 0.0], [-1.5, 1.5, 0.0], [0.0, 0.0, 0.0]]))
    np.testing.assert_allclose(floor_m[:, 2], 0.0, atol=0.012)
    # The middle of the people stays where it was on the plan.
    middle_m = TILTED.apply(np.median(walkers()[:, 2:].reshape(-1, 3), axis=0))
    assert level.level_from_given.apply(middle_m)[:2] == pytest.approx(middle_m[:2], abs=0.03)


def test_cameras_move_with_world() -> None:
    level = found(TILTED, walkers())
    assert level is not None
    points_m = walkers(num=20)
    levelled = move_world(in_world(TILTED), level.level_from_given)
    moved_m = (level.level_from_given @ TILTED).apply(points_m)
    for camera, true in zip(levelled, CAMERAS, strict=True):
        np.testing.assert_allclose(project(camera, moved_m), project(true, points_m), atol=1e-6)
    assert find_level(levelled, seen(CAMERAS, walkers()), JOINTS) is None


def test_world_on_its_side_is_turned_by_upright_people() -> None:
    """People who stand at one place determine no floor, but a vertical far from Z is beyond doubt."""
    side = Rigid3(Rotation.from_euler("x", -90.0, degrees=True).as_matrix(), np.zeros(3))
    level = found(side, walkers(reach_m=0.2))
    assert level is not None
    assert level.tilt_deg == pytest.approx(90.0, abs=1.0)
    assert (level.level_from_given @ side).rotation[2, 2] == pytest.approx(1.0, abs=1e-3)


def test_feet_at_one_place_correct_height_alone() -> None:
    level = found(TILTED, walkers(reach_m=0.2))
    assert level is not None
    assert level.tilt_deg == 0.0
    np.testing.assert_array_equal(level.level_from_given.rotation, np.eye(3))
    assert level.height_m == pytest.approx(0.4, abs=0.03)


@pytest.mark.parametrize(
    ("given_from_true", "points_m"),
    [
        (Rigid3(np.eye(3), np.zeros(3)), walkers()),
        (Rigid3(Rotation.from_euler("x", 2.0, degrees=True).as_matrix(), np.array([0.0, 0.0, 0.1])), walkers()),
        (Rigid3(np.eye(3), np.array([0.0, 0.0, 0.4])), walkers(num=30)),
    ],
    ids=["level", "nearly level", "too few poses"],
)
def test_good_world_is_left_alone(given_from_true: Rigid3, points_m: Bodies) -> None:
    assert found(given_from_true, points_m) is None


def test_upright_people_on_ramp_do_not_turn_world() -> None:
    ramp = walkers()
    ramp[..., 2] += 0.14 * ramp[..., :1].mean(1)  # 8 degrees; bodies stay upright
    level = found(Rigid3(np.eye(3), np.zeros(3)), ramp)
    assert level is None or level.tilt_deg == 0.0


def test_feet_at_two_heights_determine_no_floor() -> None:
    """Half of the feet on a stage of half a metre."""
    stage = walkers()
    stage[::2, :, 2] += 0.5
    assert found(Rigid3(np.eye(3), np.zeros(3)), stage) is None


def test_joints_without_ankles_determine_nothing() -> None:
    poses = seen(CAMERAS, walkers())
    assert find_level(CAMERAS, poses, JointSet(("a", "b", "c", "d"), ())) is None
    assert find_level(CAMERAS, [], JOINTS) is None


UNMOVED = Rigid3(np.eye(3), np.zeros(3))


def lying(heading_deg: float) -> Bodies:
    """Somebody who lies on the back, and lifts a foot now and then."""
    return turned_over(walkers(reach_m=0.05), 88.0, heading_deg)


def turned_over(points_m: Bodies, lean_deg: float, heading_deg: float) -> Bodies:
    """People who lean about their ankles from the vertical, towards a heading."""
    turn = Rotation.from_euler("zx", [-heading_deg, lean_deg], degrees=True)
    feet_m = points_m[:, 2:].mean(1, keepdims=True)
    return feet_m + (points_m - feet_m) @ turn.as_matrix()


@pytest.mark.parametrize("heading_deg", [0.0, 45.0, 90.0, 200.0])
@pytest.mark.parametrize(
    "cameras",
    [ring(5), ring(4), ring(4)[:3], ring(16)[:3]],
    ids=["five", "four", "three sides", "one side"],
)
def test_people_who_lie_turn_no_world_whose_cameras_are_upright(
    cameras: tuple[Camera, ...], heading_deg: float
) -> None:
    points_m = lying(heading_deg)
    poses = seen(cameras, points_m)
    assert find_level(cameras, poses, JOINTS) is None


@pytest.mark.parametrize("heading_deg", [0.0, 90.0])
def test_lean_that_cameras_deny_turns_no_world(heading_deg: float) -> None:
    """People of one build who all lean by 12 degrees, in front of level cameras."""
    level = found(UNMOVED, turned_over(walkers(reach_m=0.2), 12.0, heading_deg))
    assert level is None or level.tilt_deg == 0.0


def test_rolls_of_some_degrees_leave_decision_to_people() -> None:
    """Handheld cameras, and a world that is tilted by 6 degrees."""
    rng = np.random.default_rng(3)
    rolls = Rotation.from_euler("z", rng.normal(0.0, 5.0, (len(CAMERAS), 1)), degrees=True).as_matrix()
    cameras = tuple(
        replace(camera, cam_from_world=Rigid3(roll, np.zeros(3)) @ camera.cam_from_world)
        for camera, roll in zip(CAMERAS, rolls, strict=True)
    )
    given = tuple(replace(camera, cam_from_world=camera.cam_from_world @ TILTED.inverse()) for camera in cameras)
    level = find_level(given, seen(cameras, walkers()), JOINTS)
    assert level is not None
    assert level.tilt_deg == pytest.approx(np.hypot(5.0, 3.0), abs=0.2)


def test_feet_of_people_who_stand_on_their_hands_are_no_floor() -> None:
    inverted_m = walkers() * [1.0, 1.0, -1.0] + [0.0, 0.0, 1.7]
    assert found(UNMOVED, inverted_m) is None


def test_feet_of_people_who_hang_by_their_hands_are_no_floor() -> None:
    joints = JointSet((*JOINTS.names, "left_wrist", "right_wrist"), ())
    half_m = np.array([0.0, 0.0, 0.5])
    hanging_m = half_m + np.concatenate([walkers(), walkers()[:, :2] + half_m], axis=1)
    assert find_level(CAMERAS, seen(CAMERAS, hanging_m), joints) is None
    standing_m = half_m + np.concatenate([walkers(), walkers()[:, :2] - half_m], axis=1)
    level = find_level(CAMERAS, seen(CAMERAS, standing_m), joints)
    assert level is not None
    assert level.height_m == pytest.approx(0.5, abs=0.02)
