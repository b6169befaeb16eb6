"""Frames in which a hand was seen well, and the pose at the start of its fit."""

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.core.joints import WHOLE_BODY, finger_joints
from pipeline.motion.skeleton.hands.anatomy import natural_rad
from pipeline.motion.skeleton.hands.hand_fit import seen_well, start_pose
from pipeline.motion.skeleton.model import joint_pose
from tests.pipeline.motion.skeleton.hands.people import RATE_HZ, gesturing, hinge_angles_rad, landmarks_of

NUM_FRAMES = 90
LEFT = WHOLE_BODY.indices(finger_joints("left"))
WRIST = WHOLE_BODY.index("left_wrist")


def located() -> tuple[np.ndarray, np.ndarray]:
    """Left wrist and fingers."""
    xyz_m = landmarks_of(gesturing(NUM_FRAMES))
    return xyz_m[:, WRIST], xyz_m[:, LEFT]


def seen(fingers_m: np.ndarray, wrist_m: np.ndarray | None = None) -> np.ndarray:
    measured = np.isfinite(fingers_m).all(-1)
    return seen_well(located()[0] if wrist_m is None else wrist_m, fingers_m, measured, RATE_HZ)


def test_hand_with_few_joints_or_no_knuckles_is_unseen() -> None:
    _, fingers_m = located()
    assert seen(fingers_m).all()
    fingers_m[10:20, 7:] = np.nan  # seven joints are left, one of them a knuckle
    fingers_m[40:50, [4, 8, 12, 16]] = np.nan
    expected = np.ones(NUM_FRAMES, bool)
    expected[10:20] = expected[40:50] = False
    np.testing.assert_array_equal(seen(fingers_m), expected)


def test_hand_far_from_its_wrist_is_another_s() -> None:
    wrist_m, fingers_m = located()
    wrist_m[30:60] += [0.3, 0.0, 0.0]
    is_seen = seen(fingers_m, wrist_m)
    assert not is_seen[30:60].any()
    assert is_seen[:30].all()


def test_glimpse_is_not_enough() -> None:
    _, fingers_m = located()
    fingers_m[20:40], fingers_m[42:60] = np.nan, np.nan
    assert not seen(fingers_m)[20:60].any()


def test_start_of_hand_is_known_pose_and_natural_elsewhere() -> None:
    motion = gesturing(NUM_FRAMES)
    wrist_m, fingers_m = located()
    _, forearm = joint_pose(motion, "LeftForeArm")
    is_seen = np.ones(NUM_FRAMES, bool)
    is_seen[30:80] = False
    fingers_m[~is_seen] = np.nan
    points_m = np.concatenate([wrist_m[:, None], fingers_m], axis=1)
    pose = start_pose("left", forearm, points_m, is_seen, motion.bone_length_m, RATE_HZ)
    true_rad = hinge_angles_rad(NUM_FRAMES)
    bent = true_rad[is_seen][:, 1::4] > 1.0  # of a finger that is bent far, the spread is unknown
    error_rad = np.abs(pose.angle_rad - true_rad)[is_seen].reshape(-1, 5, 4)
    assert error_rad[~bent].max() < np.radians(1.0)
    np.testing.assert_allclose(pose.angle_rad[50:60], np.tile(natural_rad(), (10, 1)), atol=np.radians(1.0))
    _, world_from_hand = joint_pose(motion, "LeftHand")
    wrong = (forearm * pose.forearm_from_hand).inv() * world_from_hand
    assert np.degrees(wrong.magnitude()[is_seen].max()) < 1.0
    assert pose.forearm_from_hand.magnitude()[50:60].max() < 1e-6
    step_rad = (pose.forearm_from_hand[:-1].inv() * pose.forearm_from_hand[1:]).magnitude()
    assert np.degrees(step_rad.max()) < 15.0


def test_hand_that_was_never_seen_is_natural() -> None:
    points_m = np.full((5, 21, 3), np.nan)
    never = np.zeros(5, bool)
    pose = start_pose("right", Rotation.identity(5), points_m, never, gesturing(1).bone_length_m, RATE_HZ)
    np.testing.assert_array_equal(pose.angle_rad, np.tile(natural_rad(), (5, 1)))
    assert pose.forearm_from_hand.magnitude().max() == 0.0
