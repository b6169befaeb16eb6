"""Test pattern: a person of right proportions who walks, with fingers that move."""

from itertools import islice

import numpy as np
import pytest

from pipeline.core.data.animation import SkeletonMotion
from pipeline.motion.skeleton.model import INDEX, forward_kinematics
from pipeline.run.live.outputs.fingers import FingerPoses
from pipeline.run.live.outputs.pattern import LAYOUT, pattern_instants

JOINTS = LAYOUT.joints


def test_pattern_person_walks_on_floor_facing_ahead() -> None:
    roots_m, feet_m, noses_m = [], [], []
    for instant in islice(pattern_instants(rate_hz=30.0), 180):
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
    (person,) = next(islice(pattern_instants(), 40, None)).people
    pose = person.skeleton
    assert pose is not None
    motion = SkeletonMotion(1, "", 0, 60.0, pose.bone_length_m, pose.root_m[None], pose.parent_from_joint[None], ())
    np.testing.assert_allclose(forward_kinematics(motion)[0], pose.joint_m, atol=1e-9)
    for mark, joint in (("left_wrist", "LeftHand"), ("right_knee", "RightLeg"), ("left_ankle", "LeftFoot")):
        np.testing.assert_allclose(person.xyz_m[JOINTS.index(mark)], pose.joint_m[INDEX[joint]], atol=1e-9)


def test_pattern_people_are_apart_and_fingers_are_at_marks() -> None:
    instant = next(islice(pattern_instants(4), 100, None))
    assert [person.id for person in instant.people] == [1, 2, 3, 4]
    roots_m = [person.xyz_m[JOINTS.index("nose")] for person in instant.people]
    assert min(np.linalg.norm(roots_m[0] - other_m) for other_m in roots_m[1:]) > 0.5
    for person in FingerPoses(JOINTS.names).with_fingers(instant).people:
        assert person.skeleton is not None
        tip_m = person.skeleton.joint_m[INDEX["LeftHandIndex3End"]]
        np.testing.assert_allclose(tip_m, person.xyz_m[JOINTS.index("left_index_tip")], atol=1e-6)
