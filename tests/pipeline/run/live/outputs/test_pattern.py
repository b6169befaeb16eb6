"""Test pattern: a person of right proportions who walks, with fingers that move."""

import threading
import time

import numpy as np
import pytest

from pipeline.core.data.animation import SkeletonMotion
from pipeline.motion.skeleton.model import INDEX, forward_kinematics
from pipeline.run.live.outputs.fingers import FingerPoses
from pipeline.run.live.outputs.pattern import LAYOUT, RATE_HZ, pattern_instants, play_pattern
from pipeline.run.live.records import LiveInstant

JOINTS = LAYOUT.joints


def test_pattern_person_walks_on_floor_facing_ahead() -> None:
    roots_m, feet_m, noses_m = [], [], []
    for instant in map(pattern_instants(rate_hz=30.0), range(180)):
        (person,) = instant.people
        assert np.isfinite(person.xyz_m).all()
        assert person.skeleton is not None
        roots_m.append(person.skeleton.root_m)
        feet_m.append(person.xyz_m[JOINTS.indices(("left_big_toe", "right_big_toe", "left_heel", "right_heel")), 2])
        noses_m.append(person.xyz_m[JOINTS.index("nose")])
    lowest_m = np.min(feet_m, axis=1)
    assert lowest_m.min() > -0.06
    assert lowest_m.max() < 0.12
    walked_m = np.diff(roots_m, axis=0)[:, :2]
    ahead_m = (np.array(noses_m) - roots_m)[:-1, :2]
    assert (walked_m * ahead_m).sum(-1).min() > 0
    assert np.linalg.norm(walked_m, axis=-1) * 30.0 == pytest.approx(2 * np.pi * 0.8 / 6.0, rel=0.01)


def test_pattern_skeleton_is_at_marks() -> None:
    (person,) = pattern_instants()(40).people
    pose = person.skeleton
    assert pose is not None
    motion = SkeletonMotion(1, "", 0, 60.0, pose.bone_length_m, pose.root_m[None], pose.parent_from_joint[None], ())
    np.testing.assert_allclose(forward_kinematics(motion)[0], pose.joint_m, atol=1e-9)
    for mark, joint in (("left_wrist", "LeftHand"), ("right_knee", "RightLeg"), ("left_ankle", "LeftFoot")):
        np.testing.assert_allclose(person.xyz_m[JOINTS.index(mark)], pose.joint_m[INDEX[joint]], atol=1e-9)


def test_pattern_people_are_apart_and_fingers_are_at_marks() -> None:
    instant = pattern_instants(4)(100)
    assert [person.id for person in instant.people] == [1, 2, 3, 4]
    roots_m = [person.xyz_m[JOINTS.index("nose")] for person in instant.people]
    assert min(np.linalg.norm(roots_m[0] - other_m) for other_m in roots_m[1:]) > 0.5
    for person in FingerPoses(JOINTS.names).with_fingers(instant).people:
        assert person.skeleton is not None
        tip_m = person.skeleton.joint_m[INDEX["LeftHandIndex3End"]]
        np.testing.assert_allclose(tip_m, person.xyz_m[JOINTS.index("left_index_tip")], atol=1e-6)


def test_missed_instants_of_pattern_are_left_out() -> None:
    """A stall of half a second is a gap, not a burst behind it."""
    stopped = threading.Event()
    shown_s: list[tuple[float, float]] = []
    ticks_s: list[float] = []

    def show(instant: LiveInstant) -> None:
        if len(shown_s) == 5:
            time.sleep(0.5)
        shown_s.append((instant.time_s, time.monotonic()))
        if instant.time_s > 1.1:
            stopped.set()

    play_pattern(show, ticks_s.append, stopped)
    times_s = [time_s for time_s, _ in shown_s]
    assert times_s[6] - times_s[5] > 0.45
    late_s = [arrived_s - time_s for time_s, arrived_s in shown_s]
    # Behind the stall each instant is shown at its time, or later if the machine is busy.
    assert min(late_s[6:]) > min(late_s) - 1 / RATE_HZ
    seconds = [int(tick_s) for tick_s in ticks_s]
    assert seconds[0] >= 1
    assert seconds == sorted(set(seconds))
