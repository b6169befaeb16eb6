"""Occlusion of joints by bodies and boxes."""

import numpy as np
import pytest

from pipeline.core.joints import COCO_17
from pipeline.geometry.camera import look_at
from pipeline.validation.simulation.motion.performance import joints_at, perform
from pipeline.validation.simulation.motion.script import Role
from pipeline.validation.simulation.views.occlusion import Box, hidden_by_bodies, hidden_by_boxes

EYE = np.array([-4.0, 0.0, 1.2])
TRUNK = COCO_17.indices(("left_hip", "right_hip", "left_shoulder", "right_shoulder"))


def standing(x: float, y: float) -> np.ndarray:
    """Joints of a person who faces the camera."""
    person = perform(Role((x, y), np.pi, ()), 1.0, np.random.default_rng(3))
    return joints_at(person, np.array([0.5]))


def hidden(*places: tuple[float, float]) -> np.ndarray:
    in_cam_m = look_at(EYE, np.array([0.0, 0.0, 1.2])).apply(np.stack([standing(*place) for place in places]))
    return hidden_by_bodies(in_cam_m)[:, 0]


def test_far_one_of_two_in_line_is_hidden() -> None:
    far, near = hidden((2.0, 0.0), (0.0, 0.0))
    assert far[TRUNK].all()
    assert far.mean() > 0.6
    assert not near.any()


def test_order_does_not_matter() -> None:
    np.testing.assert_array_equal(hidden((2.0, 0.0), (0.0, 0.0)), hidden((0.0, 0.0), (2.0, 0.0))[::-1])


def test_people_side_by_side_hide_nothing() -> None:
    assert not hidden((0.0, -0.7), (0.0, 0.7)).any()


def test_half_of_body_can_be_hidden() -> None:
    far, _ = hidden((1.0, 0.25), (0.0, 0.0))
    assert 0.1 < far.mean() < 0.8


def test_arm_behind_own_trunk_is_hidden() -> None:
    """From the right side the left arm is hidden and the right arm is not."""
    person = perform(Role((0.0, 0.0), np.pi / 2, ()), 1.0, np.random.default_rng(3))
    joints_m = joints_at(person, np.array([0.5]))[None]
    right, left = (
        hidden_by_bodies(look_at(np.array([side * 4.0, 0.0, 1.2]), np.array([0.0, 0.0, 1.2])).apply(joints_m))[0, 0]
        for side in (1.0, -1.0)
    )
    assert right[COCO_17.index("left_elbow")]
    assert not right[COCO_17.indices(("right_elbow", "right_wrist"))].any()
    assert left[COCO_17.index("right_elbow")]
    assert not left[COCO_17.indices(("left_elbow", "left_wrist"))].any()


def test_absent_people_hide_nothing() -> None:
    in_cam_m = look_at(EYE, np.zeros(3)).apply(np.stack([standing(2.0, 0.0), np.full((1, 17, 3), np.nan)]))
    assert not hidden_by_bodies(in_cam_m).any()


@pytest.mark.parametrize(
    ("point", "expected"),
    [
        ((2.0, 0.0, 0.5), True),
        ((2.0, 0.0, 3.0), False),
        ((2.0, 3.0, 0.5), False),
        ((-1.0, 0.0, 0.5), False),
        ((-6.0, 0.0, 0.5), False),
        ((0.0, 0.0, 0.5), True),
        ((np.nan, np.nan, np.nan), False),
    ],
)
def test_boxes_hide_what_is_behind_them(point: tuple[float, float, float], expected: bool) -> None:
    box = Box((-0.5, -1.0, 0.0), (0.5, 1.0, 1.5))
    assert hidden_by_boxes(EYE, np.array(point), [box]) == expected
    assert not hidden_by_boxes(EYE, np.array(point), [])
