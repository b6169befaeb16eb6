"""Frames of a take lie at the times of the sender, and have all people."""

import math

import pytest

from api.blender.extension.glb_motion import PersonMotion
from api.blender.extension.take import LiveTake
from api.blender.extension.turns import NO_TURN, Quat

REST = PersonMotion(1.0, {"Hips": None, "Spine": "Hips"}, {"Hips": (0.0, 0.0, 1.0), "Spine": (0.0, 0.0, 0.1)}, (), {})
START_S = 500.0


def turn(degrees: float) -> Quat:
    """Rotation about Z."""
    return (math.cos(math.radians(degrees) / 2), 0.0, 0.0, math.sin(math.radians(degrees) / 2))


def add(
    take: LiveTake, person: int, now_s: float, sent_s: float | None, x_m: float = 0.0, degrees: float = 0.0
) -> None:
    take.add(person, START_S + now_s, sent_s, REST, ({"Hips": NO_TURN, "Spine": turn(degrees)}, (x_m, 0.0, 1.0)))


def xs_m(take: LiveTake, person: int, now_s: float) -> list[float]:
    return [x_m for x_m, _, _ in dict(take.motions(START_S + now_s))[person].roots_m]


def test_frames_are_between_poses_at_senders_times() -> None:
    """Poses of 60 Hz come late by turns; frames of 25 Hz have the places at their own times."""
    take = LiveTake("Walk 1", 25.0, START_S)
    for number in range(61):
        sent_s = number / 60
        add(take, 1, sent_s + 0.1 * (number % 3 == 1), 1000.0 + sent_s, x_m=sent_s, degrees=90 * sent_s)
    ((_, motion),) = take.motions(START_S + 1.0)
    assert motion.frame_rate_hz == 25.0
    assert xs_m(take, 1, 1.0) == pytest.approx([frame / 25 for frame in range(26)])
    for frame, spine in enumerate(motion.turns["Spine"]):
        assert spine == pytest.approx(turn(90 * frame / 25), abs=1e-6)


def test_missing_person_keeps_pose_and_comes_back() -> None:
    """Between the last pose and the next there is no slide; people who come later and go have all frames."""
    take = LiveTake("Walk 1", 10.0, START_S)
    for time_s, x_m in ((0.0, 0.0), (0.1, 1.0), (1.0, 5.0), (1.1, 6.0)):
        add(take, 1, time_s, 7.0 + time_s, x_m)
    add(take, 2, 0.5, 7.5, 2.0)
    assert xs_m(take, 1, 1.5) == pytest.approx([0.0, *[1.0] * 9, 5.0, *[6.0] * 5])
    assert xs_m(take, 2, 1.5) == [2.0] * 16


def test_sender_that_begins_again_continues_take() -> None:
    take = LiveTake("Walk 1", 10.0, START_S)
    add(take, 1, 0.0, 100.0, 1.0)
    add(take, 1, 2.0, 0.0, 2.0)
    add(take, 1, 2.1, 0.1, 3.0)
    assert xs_m(take, 1, 2.1) == pytest.approx([*[1.0] * 20, 2.0, 3.0])


def test_sender_without_times_is_taken_as_it_comes() -> None:
    take = LiveTake("Walk 1", 10.0, START_S)
    for time_s in (0.0, 0.2):
        add(take, 1, time_s, None, time_s)
    assert xs_m(take, 1, 0.2) == pytest.approx([0.0, 0.1, 0.2])


def test_joint_that_comes_later_rests_before() -> None:
    take = LiveTake("Walk 1", 10.0, START_S)
    add(take, 1, 0.0, None)
    pose = {"Hips": NO_TURN, "Spine": NO_TURN, "LeftHandThumb1": turn(40)}
    take.add(1, START_S + 0.1, None, REST, (pose, (0.0, 0.0, 1.0)))
    ((_, motion),) = take.motions(START_S + 0.1)
    thumb = motion.turns["LeftHandThumb1"]
    assert len(thumb) == 2
    assert thumb[1] == pytest.approx(turn(40), abs=1e-6)


def test_take_without_people_has_no_motion() -> None:
    assert list(LiveTake("Walk 1", 10.0, START_S).motions(START_S + 3.0)) == []
