import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.joints import finger_joints, hand_bones
from pipeline.motion.skeleton.model import (
    INDEX,
    SKELETON,
    WHOLE_SKELETON,
    SkeletonJoint,
    child_names,
    find_skeleton,
    forward_kinematics,
    joint_pose,
    parent_indices,
    rest_offsets_m,
)

STATURE_M = 1.8
BOTH = pytest.mark.parametrize("skeleton", [SKELETON, WHOLE_SKELETON])


def motion(skeleton: tuple[SkeletonJoint, ...] = SKELETON, **turned: Rotation) -> SkeletonMotion:
    """Make a frame of an adult in rest pose at the origin with some joints turned."""
    quat = np.tile([0.0, 0.0, 0.0, 1.0], (1, len(skeleton), 1))
    for name, rotation in turned.items():
        quat[0, INDEX[name]] = rotation.as_quat()
    return SkeletonMotion(
        track_id=1,
        name="person-1",
        start_frame=0,
        frame_rate_hz=25.0,
        bone_length_m=np.array([STATURE_M * joint.stature_share for joint in skeleton]),
        root_m=np.zeros((1, 3)),
        parent_from_joint=quat,
        contacts=(),
    )


def positions_m(shown: SkeletonMotion) -> dict[str, np.ndarray]:
    """Return the positions of a motion's joints in its first frame by name."""
    names = [joint.name for joint in find_skeleton(len(shown.bone_length_m))]
    return dict(zip(names, forward_kinematics(shown)[0], strict=True))


@BOTH
def test_skeleton_has_parents_first_and_ends_on_one_joint(skeleton: tuple[SkeletonJoint, ...]) -> None:
    children = child_names(len(skeleton))
    assert find_skeleton(len(skeleton)) is skeleton
    assert set(children) == {joint.name for joint in skeleton}
    for index, joint in enumerate(skeleton):
        assert INDEX[joint.name] == index
        assert (
            joint.parent is None
            if index == 0
            else INDEX[str(joint.parent)] == parent_indices(len(skeleton))[index] < index
        )
        assert (not children[joint.name]) == joint.name.endswith("End")
        assert not joint.parent or joint.name in children[joint.parent]
        np.testing.assert_allclose(np.linalg.norm(joint.rest_direction), 1.0)


def test_other_numbers_of_joints_have_no_skeleton() -> None:
    for function in (find_skeleton, parent_indices, child_names):
        with pytest.raises(ValueError, match="23 joints"):
            function(23)
    with pytest.raises(ValueError, match="25 joints"):
        rest_offsets_m(np.ones(25))


def test_fingers_follow_joints_of_body() -> None:
    assert WHOLE_SKELETON[: len(SKELETON)] == SKELETON
    assert len(WHOLE_SKELETON) == 64
    assert child_names(24)["LeftHand"] == ("LeftHandEnd",)
    bases = tuple(f"LeftHand{finger}1" for finger in ("Thumb", "Index", "Middle", "Ring", "Pinky"))
    assert child_names(64)["LeftHand"] == ("LeftHandEnd", *bases)
    names = [joint.name for joint in WHOLE_SKELETON[24:28]]
    assert names == ["LeftHandThumb1", "LeftHandThumb2", "LeftHandThumb3", "LeftHandThumb3End"]


@pytest.mark.parametrize("side", ["left", "right"])
def test_each_joint_of_finger_has_its_landmark_and_bone(side: str) -> None:
    by_landmark = {joint.landmarks: joint for joint in WHOLE_SKELETON}
    fingers = [by_landmark[(name,)] for name in finger_joints(side)]
    assert [INDEX[joint.name] for joint in fingers] == list(range(24, 44) if side == "left" else range(44, 64))
    for above, below in hand_bones(side):
        assert by_landmark[(below,)].parent == by_landmark[(above,)].name


def test_rest_pose_is_t_pose_that_faces_minus_y() -> None:
    at = positions_m(motion())
    assert at["HeadEnd"][2] - at["LeftFootEnd"][2] > 0.99 * STATURE_M
    assert at["HeadEnd"][2] - at["LeftFootEnd"][2] < 1.01 * STATURE_M
    assert at["LeftFootEnd"][1] < at["LeftFoot"][1] - 0.1
    for name in ("LeftForeArm", "LeftHand", "LeftHandEnd"):
        np.testing.assert_allclose(at[name][1:], at["Neck"][1:], atol=1e-12)
    assert 0 < at["LeftArm"][0] < at["LeftForeArm"][0] < at["LeftHand"][0] < at["LeftHandEnd"][0]
    np.testing.assert_allclose(at["RightHand"], at["LeftHand"] * [-1, 1, 1], atol=1e-12)
    assert at["LeftUpLeg"][0] > 0 > at["RightUpLeg"][0]


def test_rotation_moves_everything_below_it_and_nothing_else() -> None:
    rest = positions_m(motion())
    # +X to -Z is a positive quarter turn about +Y.
    at = positions_m(motion(LeftArm=Rotation.from_euler("Y", 90, degrees=True)))
    arm_m = rest["LeftHandEnd"][0] - rest["LeftArm"][0]
    np.testing.assert_allclose(at["LeftHandEnd"], rest["LeftArm"] - [0, 0, arm_m], atol=1e-12)
    for name in ("LeftArm", "RightHandEnd", "HeadEnd", "LeftFootEnd"):
        np.testing.assert_allclose(at[name], rest[name], atol=1e-12)


def test_hands_at_rest_have_palms_down_and_thumbs_forward() -> None:
    shown = motion(WHOLE_SKELETON)
    at = positions_m(shown)
    body = positions_m(motion())
    for name, position_m in body.items():
        np.testing.assert_array_equal(at[name], position_m)
    fingers = ("Thumb", "Index", "Middle", "Ring", "Pinky")
    for number in ("1", "2", "3", "3End"):
        chain = [at[f"LeftHand{finger}{number}"] for finger in fingers]
        # The four fingers are in order from the front to the back, and far enough apart not to touch.
        assert (np.diff([place[1] for place in chain[1:]]) > 0.015).all()
        for finger, place in zip(fingers, chain, strict=True):
            np.testing.assert_allclose(at[f"RightHand{finger}{number}"], place * [-1, 1, 1], atol=1e-12)
    for finger in fingers[1:]:
        base, tip = at[f"LeftHand{finger}1"], at[f"LeftHand{finger}3End"]
        np.testing.assert_allclose(tip[1:], base[1:], atol=1e-12)
        assert tip[0] > base[0]
    thumb = at["LeftHandThumb3End"] - at["LeftHandThumb1"]
    assert thumb[0] > 0 > thumb[1]
    assert thumb[2] < 0
    assert at["LeftHandThumb3End"][1] < at["LeftHandIndex3End"][1] - 0.02
    # The middle finger is the longest, and ends with the hand.
    tips = {finger: at[f"LeftHand{finger}3End"][0] for finger in fingers}
    assert max(tips, key=lambda finger: tips[finger]) == "Middle"
    np.testing.assert_allclose(tips["Middle"], at["LeftHandEnd"][0], atol=0.005)


def test_hand_carries_its_fingers() -> None:
    bent = motion(WHOLE_SKELETON, LeftHand=Rotation.from_euler("Y", 90, degrees=True))
    rest, at = positions_m(motion(WHOLE_SKELETON)), positions_m(bent)
    length_m = rest["LeftHandMiddle3End"][0] - rest["LeftHandMiddle1"][0]
    np.testing.assert_allclose(at["LeftHandMiddle3End"], at["LeftHandMiddle1"] - [0, 0, length_m], atol=1e-12)
    np.testing.assert_allclose(at["RightHandMiddle3End"], rest["RightHandMiddle3End"], atol=1e-12)
    for name, position_m in at.items():
        np.testing.assert_allclose(joint_pose(bent, name)[0][0], position_m, atol=1e-12)


def test_root_carries_whole_body() -> None:
    quarter = Rotation.from_euler("Z", 90, degrees=True)
    rest, turned = forward_kinematics(motion()), forward_kinematics(motion(Hips=quarter))
    np.testing.assert_allclose(turned[0], quarter.apply(rest[0]), atol=1e-12)
