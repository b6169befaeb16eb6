"""Slots of people: a person keeps the slot, poses are held, and a slot whose person has gone gets the next one."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.motion.skeleton.model import SKELETON
from pipeline.run.live.outputs.slots import PersonSlots, blended
from pipeline.run.live.records import LiveInstant, LivePerson, LiveSkeleton

NUM_BONES = len(SKELETON)


def pose(degrees: float) -> LiveSkeleton:
    """Person whose joints are all turned by an angle, at as many metres."""
    turns = np.tile(Rotation.from_euler("x", degrees, degrees=True).as_quat(), (NUM_BONES, 1))
    return LiveSkeleton(np.full(3, degrees), turns, np.full(NUM_BONES, 0.2), np.zeros((NUM_BONES, 3)))


def instant(time_s: float, people: dict[int, LiveSkeleton | None]) -> LiveInstant:
    given = (LivePerson(number, np.zeros((17, 3)), skeleton) for number, skeleton in people.items())
    return LiveInstant(time_s, tuple(given), 0.0)


def test_slot_keeps_person_and_gets_next_one() -> None:
    slots, shown = PersonSlots(2), []
    for time_s, numbers in [(0.0, (1, 2, 3)), (1.0, (2, 3)), (2.5, (2, 3)), (3.0, (1, 2, 3)), (6.0, (3,))]:
        people = slots.update(instant(time_s, dict.fromkeys(numbers)))
        shown.append([person and person.id for person in people])
    assert shown == [[1, 2], [1, 2], [3, 2], [3, 2], [3, None]]


@pytest.mark.parametrize("gap", [{}, {1: None}])
def test_pose_is_held_then_blended(gap: dict[int, LiveSkeleton | None]) -> None:
    slots, roots_m = PersonSlots(1), []
    steps: list[tuple[float, dict[int, LiveSkeleton | None]]] = [(0.0, {1: pose(10.0)}), (0.1, gap), (0.2, gap)]
    steps += [(time_s, {1: pose(20.0)}) for time_s in (0.2125, 0.325, 0.45, 0.6)]
    for time_s, people in steps:
        (person,) = slots.update(instant(time_s, people))
        assert person is not None
        assert person.skeleton is not None
        roots_m.append(float(person.skeleton.root_m[0]))
    assert roots_m == pytest.approx([10.0, 10.0, 10.0, 10.0725, 15.0, 20.0, 20.0])


def test_person_who_was_never_lost_is_passed_on() -> None:
    slots, skeletons = PersonSlots(1), [pose(degrees) for degrees in (1.0, 2.0, 3.0)]
    for number, skeleton in enumerate(skeletons):
        (person,) = slots.update(instant(0.1 * number, {1: skeleton}))
        assert person is not None
        assert person.skeleton is skeleton


def test_blend_turns_shorter_way_and_moves_joints() -> None:
    first, second = pose(350.0), pose(10.0)
    middle = blended(first, second, 0.5)
    turns = Rotation.from_quat(middle.parent_from_joint).magnitude()
    np.testing.assert_allclose(turns, 0.0, atol=1e-12)
    np.testing.assert_allclose(middle.joint_m[0], middle.root_m)
    assert np.linalg.norm(middle.joint_m[1] - middle.joint_m[0]) == pytest.approx(0.2)
