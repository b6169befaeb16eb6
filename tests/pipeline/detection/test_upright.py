"""Turns of cameras by their calibration, and by people whom a detector finds in turned pictures."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.core.data.turns import turned_axes
from pipeline.core.joints import COCO_17
from pipeline.detection.bodies import ImageBodies, boxes_around
from pipeline.detection.upright import TOLERATED_DEG, find_turn, turn_of_roll
from pipeline.geometry.camera import project
from tests.pipeline.conftest import ring_camera

SHOULDERS, HIPS = (COCO_17.indices((f"left_{kind}", f"right_{kind}")) for kind in ("shoulder", "hip"))


def hanging(camera: Camera, turn_deg: float) -> Camera:
    """Camera that has to be turned counterclockwise, with its picture, by an angle about its axis to be as it was."""
    axes = np.eye(3)
    axes[:2, :2] = turned_axes(turn_deg)
    pose = camera.cam_from_world
    turned = Rigid3(read_only(axes @ pose.rotation), read_only(axes @ pose.translation_m))
    return replace(camera, cam_from_world=turned)


@pytest.mark.parametrize("turn_deg", [0.0, 90.0, 180.0, 270.0])
@pytest.mark.parametrize("lean_deg", [-TOLERATED_DEG + 1, -5.0, 0.0, 12.0, TOLERATED_DEG - 1])
def test_cameras_near_quarter_are_turned_by_it(turn_deg: float, lean_deg: float) -> None:
    assert turn_of_roll(hanging(ring_camera("left", 0.7), turn_deg + lean_deg)) == turn_deg


@given(roll_deg=st.floats(-180.0, 180.0), azimuth=st.floats(0.0, 6.0))
def test_other_cameras_are_turned_to_degree(roll_deg: float, azimuth: float) -> None:
    """Heads are above feet in the turned picture, up to what is tolerated."""
    camera = hanging(ring_camera("left", azimuth), roll_deg)
    turn_deg = turn_of_roll(camera)
    assert turn_deg is not None
    assert 0.0 <= turn_deg < 360.0
    # In the middle of the picture; the lens is ideal there.
    middle_m = camera.cam_from_world.inverse().apply(np.array([0.0, 0.0, 4.0]))
    feet_px, head_px = project(camera, middle_m + np.array([[0.0, 0.0, -0.05], [0.0, 0.0, 0.05]]))
    x, y = (head_px - feet_px) @ turned_axes(turn_deg)
    lean_deg = abs(np.degrees(np.arctan2(x, -y)))
    assert lean_deg <= (TOLERATED_DEG if turn_deg % 90 == 0 else 0.5) + 2.0
    if TOLERATED_DEG + 3 < roll_deg % 90 < 90 - TOLERATED_DEG - 3:
        assert turn_deg == pytest.approx(roll_deg % 360, abs=3.0)


@pytest.mark.parametrize(("from_vertical_deg", "is_known"), [(0.0, False), (20.0, False), (30.0, True), (90.0, True)])
@pytest.mark.parametrize("looks_down", [True, False])
def test_picture_from_above_or_below_has_no_up(from_vertical_deg: float, is_known: bool, looks_down: bool) -> None:
    tilt = np.radians(180 - from_vertical_deg if looks_down else from_vertical_deg)
    forward = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    right = np.array([0.0, -1.0, 0.0])
    rotation = np.array([right, np.cross(forward, right), forward])
    camera = replace(ring_camera("left", 0.0), cam_from_world=Rigid3(rotation, np.zeros(3)))
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    assert turn_of_roll(camera) == (0.0 if is_known else None)


class StandingPeople:
    """Detector of two people in the turned pictures of a camera, with the confidence of a network in each lean."""

    def __init__(self, turn_deg: float, confidence: Callable[[float], float], shown: Sequence[float] = (0.0, 0.0)):
        self.turn_deg = turn_deg  # Turn that brings the pictures upright
        self.confidence = confidence  # By the angle of upright people from up in the turned picture, 0 to 180
        self.shown = shown  # Leans of the people
        self.looks: list[float] = []

    def __call__(self, turn_deg: float) -> list[tuple[int, ImageBodies]]:
        self.looks.append(turn_deg)
        off_deg = abs((self.turn_deg - turn_deg + 180) % 360 - 180)
        score = self.confidence(off_deg)
        if score == 0.0:
            return [
                (frame, ImageBodies(*(np.zeros((0, *rest)) for rest in ((17, 2), (17,), (4,), ())))) for frame in (3, 9)
            ]
        points_px = np.full((2, 17, 2), 200.0)
        for body, lean_deg in enumerate(self.shown):
            points_px[body, SHOULDERS] += np.array([0.0, -50.0]) @ turned_axes(self.turn_deg + lean_deg).T
        bodies = ImageBodies(points_px, np.full((2, 17), score), boxes_around(points_px), np.full(2, score))
        return [(frame, bodies) for frame in (3, 9)]


def falling(off_deg: float) -> float:
    """Confidence of MultiPose, roughly: half in pictures upside down."""
    return 0.7 - 0.35 * off_deg / 180


def collapsing(off_deg: float) -> float:
    """Confidence of OpenPose: nobody is found in pictures that are turned by more than a quarter."""
    return max(0.0, 0.7 - 0.7 * off_deg / 90)


@pytest.mark.parametrize("turn_deg", [0.0, 90.0, 180.0, 270.0])
@pytest.mark.parametrize(("confidence", "shows_lean"), [(falling, True), (falling, False), (collapsing, False)])
def test_people_show_turn_of_camera_of_which_nothing_is_known(
    turn_deg: float, confidence: Callable[[float], float], shows_lean: bool
) -> None:
    people = StandingPeople(turn_deg, confidence)
    found_deg, bodies = find_turn(None, COCO_17, people, shows_lean)
    assert found_deg == turn_deg
    assert [frame for frame, _ in bodies] == [3, 9]
    assert bodies[0][1].score[0, 0] == confidence(0.0)
    # Upright people need one look, and leaning people say where to look next.
    expected = [0.0, turn_deg][: 2 if turn_deg else 1]
    assert people.looks == expected if shows_lean else sorted(people.looks) == [0.0, 90.0, 180.0, 270.0]


@pytest.mark.parametrize("actual_deg", [0.0, 180.0, 270.0])
@pytest.mark.parametrize("known_deg", [47.0, 90.0, 180.0])
@pytest.mark.parametrize("shows_lean", [True, False])
def test_world_that_is_not_level_turns_no_picture_wrongly(
    actual_deg: float, known_deg: float, shows_lean: bool
) -> None:
    found_deg, _ = find_turn(known_deg, COCO_17, StandingPeople(actual_deg, falling), shows_lean)
    assert found_deg == actual_deg


def test_known_turn_is_confirmed_by_one_look() -> None:
    people = StandingPeople(137.0, falling)
    assert find_turn(137.0, COCO_17, people, shows_lean=True)[0] == 137.0
    assert people.looks == [137.0]
    # A network that finds nobody in turned pictures needs a look at the picture as it is.
    people = StandingPeople(137.0, collapsing)
    assert find_turn(137.0, COCO_17, people, shows_lean=False)[0] == 137.0
    assert people.looks == [137.0, 0.0]


def test_upright_camera_stays_upright_whatever_people_do() -> None:
    people = StandingPeople(0.0, falling, shown=(90.0, 90.0))  # they lie
    assert find_turn(0.0, COCO_17, people, shows_lean=True)[0] == 0.0
    assert people.looks == [0.0]


@pytest.mark.parametrize("known_deg", [None, 180.0])
@pytest.mark.parametrize("shows_lean", [True, False])
def test_without_people_calibration_counts(known_deg: float | None, shows_lean: bool) -> None:
    nobody = StandingPeople(0.0, lambda _: 0.0)
    assert find_turn(known_deg, COCO_17, nobody, shows_lean)[0] == (known_deg or 0.0)


def test_people_of_any_lean_turn_nothing() -> None:
    """Seen from above, people lie in any direction, and one turn is as good as the other."""
    people = StandingPeople(0.0, lambda _: 0.5, shown=(70.0, -170.0))
    assert find_turn(None, COCO_17, people, shows_lean=True)[0] == 0.0
    assert sorted(people.looks) == [0.0, 90.0, 180.0, 270.0]


def test_joints_that_do_not_count_show_no_lean() -> None:
    looks = []

    def guesses(turn_deg: float) -> list[tuple[int, ImageBodies]]:
        looks.append(turn_deg)
        ((frame, bodies), _) = StandingPeople(turn_deg, lambda _: 0.6)(turn_deg)
        score = bodies.score.copy()
        score[1] = 0.1
        keypoints_px = bodies.keypoints_px.copy()
        keypoints_px[1, HIPS] -= 500.0 * turned_axes(turn_deg)[:, 1]  # a guess of somebody upside down
        keypoints_px[0, SHOULDERS[0]] = np.nan
        score[0, SHOULDERS[0]] = 0.0
        return [(frame, replace(bodies, keypoints_px=keypoints_px, score=score))]

    assert find_turn(None, COCO_17, guesses, shows_lean=True)[0] == 0.0
    assert looks == [0.0]
