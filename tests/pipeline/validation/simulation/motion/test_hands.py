"""Simulated hands: constant bones, anatomical limits, left and right alike, and smooth motion."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.core.joints import FINGERS, WHOLE_BODY, hand_bones
from pipeline.validation.simulation.motion.hands import ANGLES, LIMITS_RAD, REST, Hands, finger_motion, fingers
from pipeline.validation.simulation.motion.performance import SimulatedPerson, joints_at, perform
from pipeline.validation.simulation.motion.script import Gesture, Role, Stay, Walk

WRISTS = WHOLE_BODY.indices(("left_wrist", "right_wrist"))


def act(*gestures: Gesture, seed: int = 1, duration_s: float = 6.0) -> SimulatedPerson:
    cues = tuple(Stay(duration_s / len(gestures), gesture) for gesture in gestures)
    return perform(Role((0.0, 0.0), 0.0, cues), duration_s, np.random.default_rng(seed), WHOLE_BODY)


def hanging(**angles_deg: float) -> dict[str, np.ndarray]:
    """Joints of the left and of the right hand of arms that reach ahead, elbows at the sides, in metres.

    X is ahead, Y left, Z up. The elbows are bent by a right angle.
    """
    angles = np.zeros((1, 2, len(ANGLES)))
    for name, angle in angles_deg.items():
        angles[..., ANGLES.index(name)] = np.radians(angle)
    sides = np.array([[0.0, 0.2, 0.0], [0.0, -0.2, 0.0]])[None]
    points_m = fingers(
        Hands(1.0, angles), sides + np.array([0.0, 0.0, 0.3]), sides, sides + np.array([0.25, 0.0, 0.0])
    )[0]
    return dict(zip(WHOLE_BODY.names[21:], points_m, strict=True))


@settings(max_examples=15, deadline=None)
@given(gesture=st.sampled_from(Gesture), seed=st.integers(0, 100))
def test_bones_keep_their_length(gesture: Gesture, seed: int) -> None:
    points_m = joints_at(act(gesture, seed=seed), np.linspace(0.0, 6.0, 100))
    for side in ("left", "right"):
        for first, second in hand_bones(side):
            bone_m = np.linalg.norm(
                points_m[:, WHOLE_BODY.index(first)] - points_m[:, WHOLE_BODY.index(second)], axis=-1
            )
            assert np.ptp(bone_m) < 1e-9, (first, second)
            assert 0.012 < bone_m[0] < 0.12


@settings(max_examples=15, deadline=None)
@given(gestures=st.lists(st.sampled_from(Gesture), min_size=1, max_size=3), seed=st.integers(0, 1000))
def test_angles_are_within_their_limits_and_change_smoothly(gestures: list[Gesture], seed: int) -> None:
    rows = [slice(400 * k, 400 * (k + 1)) for k in range(len(gestures))]
    cues = [Stay(2.0, gesture) for gesture in gestures]
    angles = finger_motion(cues, rows, 400 * len(gestures), np.random.default_rng(seed))
    assert (angles >= LIMITS_RAD[:, 0]).all()
    assert (angles <= LIMITS_RAD[:, 1]).all()
    assert np.abs(np.diff(angles, axis=0)).max() * 200.0 < np.radians(900.0)


def test_hands_rest_without_gesture_and_between_postures() -> None:
    walking = finger_motion([Walk((3.0, 0.0))], [slice(0, 600)], 600, np.random.default_rng(2))
    assert np.abs(walking - REST).max() < np.radians(10.0)
    showing = finger_motion([Stay(10.0, Gesture.HANDS)], [slice(0, 2000)], 2000, np.random.default_rng(2))
    bends = [k for k, name in enumerate(ANGLES) if name.endswith("pip")]
    from_rest = np.abs(showing[..., bends] - REST[bends]).max(-1)
    assert np.ptp(showing[..., bends], axis=0).max(-1).min() > np.radians(60.0)
    assert 0.1 < (from_rest < np.radians(12.0)).mean() < 0.7


def test_straight_hand_is_flat_with_its_thumb_up() -> None:
    joints = hanging()
    for side, sign in (("left", 1.0), ("right", -1.0)):
        wrist_m = np.array([0.25, sign * 0.2, 0.0])
        # A neutral palm faces inwards: fingers point ahead, the thumb's side is up, and the palm is upright.
        middle_m = joints[f"{side}_middle_tip"] - wrist_m
        assert middle_m[0] == pytest.approx(0.092 + 0.045 + 0.026 + 0.021)
        assert joints[f"{side}_index_mcp"][2] > joints[f"{side}_pinky_mcp"][2] + 0.04
        assert joints[f"{side}_thumb_tip"][2] > 0.0
        assert abs(middle_m[1]) < 0.01


def test_fingers_bend_into_palm() -> None:
    straight, bent = hanging(), hanging(index_pip=90.0, thumb_ip=60.0)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        moved_m = bent[f"{side}_index_tip"] - straight[f"{side}_index_tip"]
        # Inwards of the body, where the palm faces.
        assert sign * moved_m[1] < -0.02
        np.testing.assert_array_equal(bent[f"{side}_index_pip"], straight[f"{side}_index_pip"])
        # The thumb bends down to the little finger, and inwards to the palm.
        moved_m = bent[f"{side}_thumb_tip"] - straight[f"{side}_thumb_tip"]
        assert moved_m[2] < -0.01
        assert sign * moved_m[1] < 0.0


def test_pronation_turns_palm_down_and_thumb_inwards() -> None:
    turned = hanging(pronation=80.0)
    bent = hanging(pronation=80.0, middle_pip=90.0)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        assert sign * (turned[f"{side}_index_mcp"][1] - turned[f"{side}_pinky_mcp"][1]) < -0.04
        assert bent[f"{side}_middle_tip"][2] < turned[f"{side}_middle_tip"][2] - 0.02


def test_right_hands_mirror_left_hands() -> None:
    angles = {name: 7.0 + k for k, name in enumerate(ANGLES)}
    joints = hanging(**angles)
    for finger, names in FINGERS.items():
        for name in names:
            mirrored_m = joints[f"left_{finger}_{name}"] * [1.0, -1.0, 1.0]
            np.testing.assert_allclose(joints[f"right_{finger}_{name}"], mirrored_m, atol=1e-12)


def test_hands_do_not_change_body() -> None:
    role = Role((0.0, 0.0), 0.0, (Stay(3.0, Gesture.TALK),))
    time_s = np.arange(0.0, 3.0, 0.05)
    body = joints_at(perform(role, 3.0, np.random.default_rng(3)), time_s)
    whole = joints_at(perform(role, 3.0, np.random.default_rng(3), WHOLE_BODY), time_s)
    np.testing.assert_array_equal(whole[:, :13], body[:, :13])
    assert whole.shape[1] == len(WHOLE_BODY.names)
    tips_m = whole[:, WHOLE_BODY.indices(("left_middle_tip", "right_middle_tip"))] - whole[:, WRISTS]
    assert 0.08 < np.linalg.norm(tips_m, axis=-1).min() < np.linalg.norm(tips_m, axis=-1).max() < 0.24
