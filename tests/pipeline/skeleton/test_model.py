import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.data import SkeletonMotion
from pipeline.skeleton.model import CHILDREN, INDEX, SKELETON, forward_kinematics

STATURE_M = 1.8


def motion(**turned: Rotation) -> SkeletonMotion:
    """Make a frame of an adult in rest pose at the origin with some joints turned."""
    quat = np.tile([0.0, 0.0, 0.0, 1.0], (1, len(SKELETON), 1))
    for name, rotation in turned.items():
        quat[0, INDEX[name]] = rotation.as_quat()
    return SkeletonMotion(
        track_id=1,
        name="person-1",
        start_frame=0,
        frame_rate_hz=25.0,
        bone_length_m=np.array([STATURE_M * joint.stature_share for joint in SKELETON]),
        root_m=np.zeros((1, 3)),
        parent_from_joint=quat,
        contacts=(),
    )


def test_parents_come_before_children_and_every_end_hangs_on_one_joint() -> None:
    for index, joint in enumerate(SKELETON):
        assert joint.parent is None if index == 0 else INDEX[str(joint.parent)] < index
        assert (not CHILDREN[joint.name]) == joint.name.endswith("End")
        np.testing.assert_allclose(np.linalg.norm(joint.rest_direction), 1.0)


def test_rest_pose_is_a_t_pose_that_faces_minus_y() -> None:
    at = dict(zip(INDEX, forward_kinematics(motion())[0], strict=True))
    assert at["HeadEnd"][2] - at["LeftFootEnd"][2] > 0.99 * STATURE_M
    assert at["HeadEnd"][2] - at["LeftFootEnd"][2] < 1.01 * STATURE_M
    assert at["LeftFootEnd"][1] < at["LeftFoot"][1] - 0.1
    for name in ("LeftForeArm", "LeftHand", "LeftHandEnd"):
        np.testing.assert_allclose(at[name][1:], at["Neck"][1:], atol=1e-12)
    assert 0 < at["LeftArm"][0] < at["LeftForeArm"][0] < at["LeftHand"][0] < at["LeftHandEnd"][0]
    np.testing.assert_allclose(at["RightHand"], at["LeftHand"] * [-1, 1, 1], atol=1e-12)
    assert at["LeftUpLeg"][0] > 0 > at["RightUpLeg"][0]


def test_a_rotation_moves_everything_below_it_and_nothing_else() -> None:
    rest = dict(zip(INDEX, forward_kinematics(motion())[0], strict=True))
    # +X to -Z is a positive quarter turn about +Y.
    lowered = forward_kinematics(motion(LeftArm=Rotation.from_euler("Y", 90, degrees=True)))
    at = dict(zip(INDEX, lowered[0], strict=True))
    arm_m = rest["LeftHandEnd"][0] - rest["LeftArm"][0]
    np.testing.assert_allclose(at["LeftHandEnd"], rest["LeftArm"] - [0, 0, arm_m], atol=1e-12)
    for name in ("LeftArm", "RightHandEnd", "HeadEnd", "LeftFootEnd"):
        np.testing.assert_allclose(at[name], rest[name], atol=1e-12)


def test_the_root_carries_the_whole_body() -> None:
    quarter = Rotation.from_euler("Z", 90, degrees=True)
    rest, turned = forward_kinematics(motion()), forward_kinematics(motion(Hips=quarter))
    np.testing.assert_allclose(turned[0], quarter.apply(rest[0]), atol=1e-12)
