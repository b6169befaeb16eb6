import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.joints import COCO_17, JointSet
from pipeline.motion.skeleton.fitting.fit import SkeletonFit
from pipeline.motion.skeleton.model import INDEX, SKELETON, forward_kinematics
from tests.pipeline.motion.skeleton.synthetic_tracks import (
    EARS_ABOVE_SHOULDERS_M,
    FOREARM_M,
    HALF_HIPS_M,
    HALF_SHOULDERS_M,
    SHIN_M,
    THIGH_M,
    TRUNK_M,
    UPPER_ARM_M,
    timebase,
    track_of,
    walker,
    without,
)

LENGTHS_M = {
    "Arm": HALF_SHOULDERS_M,
    "ForeArm": UPPER_ARM_M,
    "Hand": FOREARM_M,
    "UpLeg": HALF_HIPS_M,
    "Leg": THIGH_M,
    "Foot": SHIN_M,
    "Head": EARS_ABOVE_SHOULDERS_M,
}


def solve(xyz_m: np.ndarray, frame_rate_hz: float = 30.0) -> SkeletonMotion:
    return SkeletonFit(track_of(xyz_m), COCO_17, timebase(len(xyz_m), frame_rate_hz), "person-1").motion()


def errors_m(motion: SkeletonMotion, truth_m: np.ndarray) -> dict[str, np.ndarray]:
    """Distance (frames,) of each joint with landmarks from the true position."""
    positions_m = forward_kinematics(motion)
    return {
        joint.name: np.linalg.norm(
            positions_m[:, INDEX[joint.name]] - truth_m[:, COCO_17.indices(joint.landmarks)].mean(1), axis=-1
        )
        for joint in SKELETON
        if joint.landmarks
    }


def steps_deg(motion: SkeletonMotion) -> np.ndarray:
    """Angle (frames - 1, joints) between a joint's rotations in consecutive frames."""
    quat = motion.parent_from_joint
    return np.degrees(2 * np.arccos(np.clip(np.abs((quat[1:] * quat[:-1]).sum(-1)), 0, 1)))


def local(motion: SkeletonMotion, name: str) -> Rotation:
    return Rotation.from_quat(motion.parent_from_joint[:, INDEX[name]])


def assert_sound(motion: SkeletonMotion) -> None:
    assert np.isfinite(motion.root_m).all()
    assert np.isfinite(motion.bone_length_m).all()
    np.testing.assert_allclose(np.linalg.norm(motion.parent_from_joint, axis=-1), 1.0)


def test_clean_walk_is_reproduced() -> None:
    truth_m = walker(60, turn_rad=1.5)
    motion = solve(truth_m)
    assert_sound(motion)
    for name, error_m in errors_m(motion, truth_m).items():
        assert error_m.max() < 1e-3, name
    for kind, length_m in LENGTHS_M.items():
        for side in ("", "Left", "Right"):
            if (name := side + kind) in INDEX:
                assert motion.bone_length_m[INDEX[name]] == pytest.approx(length_m, abs=1e-6), name
    trunk = sum(motion.bone_length_m[INDEX[name]] for name in ("Spine", "Chest", "Neck"))
    assert trunk == pytest.approx(TRUNK_M)
    assert (motion.name, motion.track_id, motion.frame_rate_hz) == ("person-1", 1, 30.0)


def test_body_faces_where_it_walks() -> None:
    truth_m = walker(31, turn_rad=np.pi / 2)
    motion = solve(truth_m)
    np.testing.assert_allclose(
        local(motion, "Hips").as_euler("ZXY", degrees=True)[:, 0], np.linspace(0, 90, 31), atol=0.05
    )
    # The head looks ahead, and the chest isn't twisted against the hips.
    forward = truth_m[:, COCO_17.index("nose")] - truth_m[:, COCO_17.indices(("left_ear", "right_ear"))].mean(1)
    head = local(motion, "Hips")
    for name in ("Spine", "Chest", "Neck", "Head"):
        head = head * local(motion, name)
    assert (head.apply([0.0, -1.0, 0.0]) * forward / np.linalg.norm(forward, axis=-1, keepdims=True)).sum(
        -1
    ).min() > 0.98


def test_elbows_and_knees_are_hinges() -> None:
    motion = solve(walker(90, elbow_rad=lambda phase: 0.9 + 0.4 * np.sin(phase)))
    time_s = np.arange(90) / 30.0
    bends = {
        "LeftForeArm": (-2, 0.9 + 0.4 * np.sin(np.pi * time_s)),
        "RightForeArm": (2, 0.9 + 0.4 * np.sin(np.pi * time_s + np.pi)),
        "LeftLeg": (0, 0.5 + 0.3 * np.cos(np.pi * time_s)),
        "RightLeg": (0, 0.5 + 0.3 * np.cos(np.pi * time_s + np.pi)),
    }
    for name, (axis, bend_rad) in bends.items():
        rotvec = local(motion, name).as_rotvec()
        hinge = np.zeros(3)
        hinge[abs(axis)] = -1.0 if axis < 0 else 1.0
        np.testing.assert_allclose(rotvec @ hinge, bend_rad, atol=0.01, err_msg=name)
        np.testing.assert_allclose(rotvec, np.outer(bend_rad, hinge), atol=0.06, err_msg=name)


def test_noise_is_not_amplified_along_limbs() -> None:
    truth_m = walker(200, frame_rate_hz=29.97, turn_rad=2.0)
    noisy_m = truth_m + np.random.default_rng(0).normal(scale=0.02, size=truth_m.shape)
    motion = solve(noisy_m, 29.97)
    distances_m = errors_m(motion, noisy_m)
    assert np.mean([error_m.mean() for error_m in distances_m.values()]) < 0.025
    # A hand hangs on eight joints, yet is no farther off than a shoulder.
    assert distances_m["LeftHand"].mean() < 0.03
    for kind, length_m in LENGTHS_M.items():
        assert motion.bone_length_m[INDEX[kind if kind == "Head" else f"Left{kind}"]] == pytest.approx(
            length_m, rel=0.05
        )


def test_full_turn_does_not_flip() -> None:
    truth_m = walker(120, turn_rad=2 * np.pi)
    motion = solve(truth_m)
    assert steps_deg(motion).max() < 6.0
    # Quaternions don't jump to the other hemisphere either, even though the turn ends on it.
    assert np.abs(np.diff(motion.parent_from_joint, axis=0)).max() < 0.06
    np.testing.assert_allclose(motion.parent_from_joint[-1, 0], -motion.parent_from_joint[0, 0], atol=1e-3)


@pytest.mark.parametrize("swing_rad", [0.0, 1.2])
def test_straight_arms_don_t_spin(swing_rad: float) -> None:
    truth_m = walker(150, turn_rad=1.0, elbow_rad=np.zeros_like, shoulder_rad=lambda phase: swing_rad * np.sin(phase))
    noisy_m = truth_m + np.random.default_rng(1).normal(scale=0.005, size=truth_m.shape)
    clean, noisy = solve(truth_m), solve(noisy_m)
    arms = [INDEX[name] for name in ("LeftArm", "LeftForeArm", "RightArm", "RightForeArm")]
    # The arms themselves swing at up to 7 degrees a frame.
    assert steps_deg(clean)[:, arms].max() < 11.0
    assert steps_deg(noisy)[:, arms].max() < 20.0
    assert errors_m(clean, truth_m)["LeftHand"].max() < 1e-3


def test_full_circle_of_straight_arm_does_not_flip() -> None:
    truth_m = walker(120, elbow_rad=np.zeros_like, shoulder_rad=lambda phase: phase)
    motion = solve(truth_m)
    assert steps_deg(motion).max() < 10.0
    assert errors_m(motion, truth_m)["RightHand"].max() < 1e-3


def test_gaps_travel_with_body() -> None:
    truth_m = walker(90, turn_rad=2 * np.pi, shoulder_rad=lambda phase: np.full_like(phase, 0.4))
    seen_m = without(truth_m, "left_wrist", "left_elbow", frames=slice(20, 60))
    seen_m = without(seen_m, "right_wrist", "right_elbow", frames=slice(70, 90))
    motion = solve(seen_m)
    error_m = errors_m(motion, truth_m)
    # The arms are held still while the body turns: a gap filled in the world would cut through the body.
    assert error_m["LeftHand"].max() < 0.01
    assert error_m["RightHand"].max() < 0.01
    assert steps_deg(motion).max() < 8.0


def test_hips_travel_with_shoulders_while_unseen() -> None:
    truth_m = walker(90, turn_rad=1.0)
    seen_m = without(truth_m, "left_hip", "right_hip", frames=slice(30, 60))
    seen_m = without(seen_m, "left_hip", frames=slice(60, 75))
    error_m = errors_m(solve(seen_m), truth_m)
    assert error_m["Hips"].max() < 1e-3
    assert error_m["LeftUpLeg"].max() < 1e-2


def test_joint_never_seen_takes_length_of_other_side() -> None:
    truth_m = walker(40)
    motion = solve(without(truth_m, "left_wrist"))
    assert motion.bone_length_m[INDEX["LeftHand"]] == pytest.approx(FOREARM_M)
    np.testing.assert_allclose(motion.parent_from_joint[:, INDEX["LeftForeArm"]], [[0, 0, 0, 1]] * 40, atol=1e-3)
    assert errors_m(motion, truth_m)["LeftForeArm"].max() < 1e-3


@pytest.mark.parametrize(
    "unseen", [("left_hip",), ("left_shoulder",), ("left_hip", "right_hip"), ("left_shoulder", "right_shoulder")]
)
def test_torso_is_completed(unseen: tuple[str, ...]) -> None:
    truth_m = walker(40, turn_rad=2.0)
    motion = solve(without(truth_m, *unseen))
    assert_sound(motion)
    error_m = errors_m(motion, truth_m)
    # A width or a trunk that nobody measured has adult proportions.
    assert error_m["Hips"].max() < 0.05
    assert error_m["Neck"].max() < 0.065
    assert steps_deg(motion).max() < 20.0


def test_face_may_come_and_go() -> None:
    truth_m = walker(60)
    seen_m = without(truth_m, "nose", "left_eye", "right_eye", frames=slice(10, 20))
    seen_m = without(seen_m, "left_ear", frames=slice(25, 35))
    seen_m = without(seen_m, "nose", "left_eye", "right_eye", "left_ear", "right_ear", frames=slice(40, 50))
    motion = solve(seen_m)
    assert errors_m(motion, truth_m)["Head"].max() < 1e-3
    assert steps_deg(motion)[:, INDEX["Head"]].max() < 1.0


@pytest.mark.parametrize("num_frames", [1, 2])
def test_short_tracks(num_frames: int) -> None:
    truth_m = walker(num_frames)
    motion = solve(truth_m)
    assert_sound(motion)
    assert motion.parent_from_joint.shape == (num_frames, len(SKELETON), 4)
    assert max(error_m.max() for error_m in errors_m(motion, truth_m).values()) < 1e-3


def test_nothing_seen_is_adult_in_rest_pose() -> None:
    motion = solve(np.full((3, 17, 3), np.nan))
    assert_sound(motion)
    positions_m = forward_kinematics(motion)
    assert positions_m[0, INDEX["HeadEnd"], 2] - positions_m[0, INDEX["LeftFootEnd"], 2] == pytest.approx(
        1.70, abs=0.02
    )
    np.testing.assert_allclose(motion.parent_from_joint, np.tile([0, 0, 0, 1], (3, len(SKELETON), 1)), atol=1e-12)


def test_detector_without_face_will_do() -> None:
    body = JointSet(COCO_17.names[5:], COCO_17.bones[4:])
    truth_m = walker(20)
    motion = SkeletonFit(track_of(truth_m[:, 5:]), body, timebase(20), "person-1").motion()
    assert_sound(motion)
    np.testing.assert_allclose(motion.parent_from_joint[:, INDEX["Head"]], [[0, 0, 0, 1]] * 20, atol=1e-12)
    assert errors_m(motion, truth_m)["LeftHand"].max() < 1e-3


def test_lengths_come_from_measured_frames_only() -> None:
    truth_m = walker(30)
    stretched_m = truth_m.copy()
    stretched_m[10:, COCO_17.indices(("left_wrist", "right_wrist"))] += 0.3
    track = track_of(stretched_m)
    track.source[10:, COCO_17.indices(("left_wrist", "right_wrist"))] = 3
    motion = SkeletonFit(track, COCO_17, timebase(30), "person-1").motion()
    assert motion.bone_length_m[INDEX["LeftHand"]] == pytest.approx(FOREARM_M)


def test_wild_positions_are_not_followed() -> None:
    truth_m = walker(40)
    wild_m = truth_m.copy()
    wild_m[20, COCO_17.index("left_wrist")] += [0.5, 0.8, 1.0]
    wild_m[10, COCO_17.index("nose")] += [0.0, 0.9, 0.0]
    motion = solve(wild_m)
    error_m = errors_m(motion, truth_m)
    assert error_m["LeftHand"].max() < 0.02
    assert error_m["Head"].max() < 0.02
    assert steps_deg(motion).max() < 8.0


coordinates = st.one_of(st.just(np.nan), st.sampled_from([0.0, 1.0, -1.0]), st.floats(-50, 50))


@settings(max_examples=80, deadline=None)
@given(arrays(float, st.tuples(st.integers(1, 4), st.just(17), st.just(3)), elements=coordinates))
def test_any_track_gives_sound_motion(xyz_m: np.ndarray) -> None:
    xyz_m[~np.isfinite(xyz_m).all(-1)] = np.nan
    assert_sound(solve(xyz_m))
