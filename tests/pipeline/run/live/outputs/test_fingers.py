"""Fingers of live people: joints of the skeletons are where the fingers were located."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.joints import COCO_17, finger_joints
from pipeline.motion.skeleton.feet.floor import SIDES
from pipeline.motion.skeleton.hands.anatomy import hand_fingers, joint_rotations, natural_rad
from pipeline.motion.skeleton.model import INDEX, SKELETON, WHOLE_SKELETON, forward_kinematics
from pipeline.run.live.outputs.fingers import FingerPoses
from pipeline.run.live.records import LiveInstant, LivePerson, LiveSkeleton

JOINTS = (*COCO_17.names, *finger_joints("left"), *finger_joints("right"))
LENGTHS_M = np.array([1.7 * joint.stature_share for joint in WHOLE_SKELETON])
NUM_BODY = len(SKELETON)


def posed(seed: int) -> SkeletonMotion:
    """Person in a pose at random, with bent fingers."""
    rng = np.random.default_rng(seed)
    quat = Rotation.from_rotvec(rng.normal(0.0, 0.4, (len(WHOLE_SKELETON), 3))).as_quat()
    for side in SIDES:
        numbers, rotations = joint_rotations(side, (natural_rad() * rng.uniform(0.5, 2.0))[None])
        for number, rotation in zip(numbers, rotations, strict=True):
            quat[number] = rotation.as_quat()[0]
        for finger in hand_fingers(side).values():
            quat[finger.joints[-1]] = (0.0, 0.0, 0.0, 1.0)
        quat[INDEX[f"{side.capitalize()}HandEnd"]] = (0.0, 0.0, 0.0, 1.0)
    return SkeletonMotion(1, "", 0, 25.0, LENGTHS_M, rng.normal(size=(1, 3)), quat[None], ())


def person(number: int, motion: SkeletonMotion) -> LivePerson:
    """Person whose hands are at rest in the body's skeleton, and whose fingers were located."""
    whole_m = forward_kinematics(motion)[0]
    quat = motion.parent_from_joint[0, :NUM_BODY].copy()
    quat[[INDEX["LeftHand"], INDEX["RightHand"]]] = (0.0, 0.0, 0.0, 1.0)
    xyz_m = np.full((len(JOINTS), 3), np.nan)
    for side in SIDES:
        xyz_m[JOINTS.index(f"{side}_wrist")] = whole_m[INDEX[f"{side.capitalize()}Hand"]]
        places = [place for finger in hand_fingers(side).values() for place in finger.joints]
        xyz_m[[JOINTS.index(name) for name in finger_joints(side)]] = whole_m[places]
    body = LiveSkeleton(motion.root_m[0], quat, LENGTHS_M[:NUM_BODY], whole_m[:NUM_BODY])
    return LivePerson(number, xyz_m, body)


def test_joints_are_at_located_fingers() -> None:
    motions = [posed(1), posed(2)]
    people = tuple(person(number, motion) for number, motion in enumerate(motions, 1))
    got = FingerPoses(JOINTS).with_fingers(LiveInstant(0.0, people, 0.0))
    for shown, motion in zip(got.people, motions, strict=True):
        assert shown.skeleton is not None
        np.testing.assert_allclose(shown.skeleton.joint_m, forward_kinematics(motion)[0], atol=1e-9)
        given = shown.skeleton
        again = replace(motion, root_m=given.root_m[None], parent_from_joint=given.parent_from_joint[None])
        np.testing.assert_allclose(forward_kinematics(again)[0], given.joint_m, atol=1e-9)


def test_hand_out_of_sight_keeps_pose() -> None:
    poses, seen = FingerPoses(JOINTS), person(1, posed(3))
    first = poses.with_fingers(LiveInstant(0.0, (seen,), 0.0)).people[0].skeleton
    unseen = replace(seen, xyz_m=np.full_like(seen.xyz_m, np.nan))
    second = poses.with_fingers(LiveInstant(0.1, (unseen,), 0.0)).people[0].skeleton
    assert first is not None
    assert second is not None
    np.testing.assert_allclose(second.parent_from_joint, first.parent_from_joint)


def test_people_without_fingers_stay_as_they_are() -> None:
    instant = LiveInstant(0.0, (person(1, posed(1)),), 0.0)
    assert FingerPoses(COCO_17.names).with_fingers(instant) is instant
    bodiless = LiveInstant(0.0, (replace(instant.people[0], skeleton=None),), 0.0)
    assert FingerPoses(JOINTS).with_fingers(bodiless).people[0].skeleton is None
