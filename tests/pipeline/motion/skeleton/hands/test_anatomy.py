"""Hinges of hands: angles and positions are each other's inverse, and bends go to the palm."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import Side
from pipeline.core.joints import FINGERS, finger_joints
from pipeline.motion.skeleton.feet.floor import SIDES
from pipeline.motion.skeleton.fitting.gauss_newton import JointPoses, landmark_positions
from pipeline.motion.skeleton.hands.anatomy import (
    HINGES,
    NUM_HINGES,
    articulate_hand,
    bend_angles_rad,
    hand_fingers,
    joint_rotations,
    local_rotations,
    natural_rad,
)
from pipeline.motion.skeleton.model import INDEX, WHOLE_SKELETON, forward_kinematics
from tests.pipeline.motion.skeleton.hands.people import STATURE_M, gesturing
from tests.pipeline.motion.skeleton.hands.people import landmarks_of as landmarks_of_person

LENGTHS_M = np.array([joint.stature_share for joint in WHOLE_SKELETON]) * STATURE_M
LIMITS_RAD = np.array([freedom.limits_rad for freedom in articulate_hand("left", LENGTHS_M).freedoms[3:]])


def posed_m(side: Side, angle_rad: np.ndarray) -> np.ndarray:
    """Landmarks of a hand at the origin whose axes are the world's."""
    rest = np.tile(np.eye(3), (len(angle_rad), 1, 1))
    skeleton = articulate_hand(side, LENGTHS_M)
    local = local_rotations(side, rest, rest, angle_rad)
    return landmark_positions(
        JointPoses(np.zeros((len(angle_rad), 3)), local, np.zeros((len(angle_rad), 26))), skeleton
    )


@given(st.sampled_from(SIDES), st.lists(st.floats(0.1, 0.9), min_size=NUM_HINGES, max_size=NUM_HINGES))
def test_angles_are_recovered_from_positions(side: Side, shares: list[float]) -> None:
    angle_rad = LIMITS_RAD[:, 0] + np.array(shares) * (LIMITS_RAD[:, 1] - LIMITS_RAD[:, 0])
    angle_rad[1::HINGES] = np.minimum(angle_rad[1::HINGES], 1.0)  # of a finger bent further, the spread is unknown
    np.testing.assert_allclose(bend_angles_rad(side, posed_m(side, angle_rad[None]))[0], angle_rad, atol=1e-6)


@pytest.mark.parametrize("side", SIDES)
def test_fingers_bend_to_palm_and_thumbs_to_fingers(side: Side) -> None:
    straight, bent = np.zeros((1, NUM_HINGES)), np.zeros((1, NUM_HINGES))
    bent[:, [2, 6, 10, 14, 18]] = np.radians(60.0)
    names = ("wrist", *finger_joints(side))
    before_m, after_m = (dict(zip(names, posed_m(side, angle_rad)[0], strict=True)) for angle_rad in (straight, bent))
    for finger in ("index", "middle", "ring", "pinky"):
        moved_m = after_m[f"{side}_{finger}_tip"] - before_m[f"{side}_{finger}_tip"]
        assert moved_m[2] < -0.02  # palms are down at rest
        assert moved_m[0] * (1.0 if side == "left" else -1.0) < -0.005
    pinky_m = before_m[f"{side}_pinky_mcp"]
    assert np.linalg.norm(after_m[f"{side}_thumb_tip"] - pinky_m) < np.linalg.norm(
        before_m[f"{side}_thumb_tip"] - pinky_m
    )


@pytest.mark.parametrize("side", SIDES)
def test_positive_spread_goes_to_thumb_s_side(side: Side) -> None:
    spread = np.zeros((1, NUM_HINGES))
    spread[:, HINGES::HINGES] = np.radians(15.0)
    moved_m = posed_m(side, spread)[0] - posed_m(side, np.zeros((1, NUM_HINGES)))[0]
    tips = [1 + HINGES * number + 3 for number in range(1, 5)]
    assert (moved_m[tips, 1] < -0.01).all()


def test_whole_skeleton_and_articulation_of_hands_agree() -> None:
    motion = gesturing(10)
    true_m = landmarks_of_person(motion)
    skeleton_m = forward_kinematics(motion)
    for side in SIDES:
        for finger, joints in hand_fingers(side).items():
            for joint, name in zip(joints.joints, FINGERS[finger], strict=True):
                assert WHOLE_SKELETON[joint].landmarks == (f"{side}_{finger}_{name}",)
        wrist_m = skeleton_m[:, INDEX[f"{side.capitalize()}Hand"]]
        assert np.linalg.norm(skeleton_m[:, hand_fingers(side)["index"].joints[0]] - wrist_m, axis=-1).max() < 0.12
    assert np.isfinite(true_m).all()


def test_natural_pose_is_slightly_bent_and_within_limits() -> None:
    natural = natural_rad()
    assert ((natural >= LIMITS_RAD[:, 0]) & (natural <= LIMITS_RAD[:, 1])).all()
    assert (natural.reshape(-1, HINGES)[1:, 2] > np.radians(10.0)).all()
    assert natural.max() < np.radians(45.0)


def test_rotations_of_joints_are_those_of_hinges() -> None:
    angle_rad = np.tile(natural_rad() + 0.1, (2, 1))
    numbers, rotations = joint_rotations("right", angle_rad)
    rest = np.tile(np.eye(3), (2, 1, 1))
    local = Rotation.from_matrix(local_rotations("right", rest, rest, angle_rad)[0, 2:])
    assert [WHOLE_SKELETON[number].name for number in numbers[:3]] == [f"RightHandThumb{k}" for k in (1, 2, 3)]
    for finger in range(5):
        base = local[HINGES * finger] * local[HINGES * finger + 1]
        assert (base.inv() * rotations[3 * finger][0]).magnitude() < 1e-9
        assert (local[HINGES * finger + 3].inv() * rotations[3 * finger + 2][0]).magnitude() < 1e-9
