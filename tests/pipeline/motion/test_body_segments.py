"""Angles of poses made by hand: values, and signs that are the same on both sides."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import SkeletonMotion
from pipeline.motion.angles.compute import segment_angles, segments_from
from pipeline.motion.body_segments import (
    ANGLE_NAMES,
    JOINTS,
    SEGMENTS,
    Sequence,
    angles_rad,
    continuous,
    is_locked,
    mirrored,
)
from pipeline.motion.skeleton.model import INDEX, SKELETON, WHOLE_SKELETON

X, Y, Z = np.eye(3)
# Arms of the T-pose lowered to hang beside the body; palms are then turned to the thighs.
HANGING = {"LeftArm": 90.0 * Y, "RightArm": -90.0 * Y}


def posed(turns_deg: dict[str, np.ndarray]) -> SkeletonMotion:
    """One frame of a skeleton whose joints are turned by rotation vectors in degrees, in the axes of the rest pose."""
    quat = np.tile([0.0, 0.0, 0.0, 1.0], (1, len(WHOLE_SKELETON), 1))
    for joint, turn_deg in turns_deg.items():
        quat[0, INDEX[joint]] = Rotation.from_rotvec(turn_deg, degrees=True).as_quat()
    return SkeletonMotion(1, "person-1", 0, 30.0, np.full(len(WHOLE_SKELETON), 0.3), np.zeros((1, 3)), quat, ())


def angles_deg(turns_deg: dict[str, np.ndarray]) -> dict[str, float]:
    found = np.degrees(segment_angles(segments_from(posed(turns_deg))))[0]
    return dict(zip(ANGLE_NAMES, found.tolist(), strict=True))


def both(joint: str, left_deg: np.ndarray) -> dict[str, np.ndarray]:
    """Turns of the joints of both sides that are mirror images: rotations about X are the same, others opposite."""
    return {f"Left{joint}": left_deg, f"Right{joint}": left_deg * [1.0, -1.0, -1.0]}


def turned(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Rotation vector of two turns about axes of the parent, the first one first."""
    first, second = (Rotation.from_rotvec(turn_deg, degrees=True) for turn_deg in (before, after))
    return (second * first).as_rotvec(degrees=True)


# Turns of joints; the angles that differ from those of the T-pose.
POSES: dict[str, tuple[dict[str, np.ndarray], dict[str, float]]] = {
    "pelvis to the world's X": ({"Hips": 90.0 * Z}, {"pelvis_rotation": 0.0}),
    "pelvis to the left": ({"Hips": 120.0 * Z}, {"pelvis_rotation": 30.0}),
    "pelvis to the front": ({"Hips": 15.0 * X}, {"pelvis_tilt": 15.0}),
    "right side lower": ({"Hips": -10.0 * Y}, {"pelvis_obliquity": 10.0}),
    "trunk to the front": ({"Spine": 10.0 * X, "Chest": 15.0 * X}, {"trunk_flexion": 25.0}),
    "trunk to the right": ({"Chest": -20.0 * Y}, {"trunk_bending": 20.0}),
    "trunk to the left": ({"Spine": 12.0 * Z}, {"trunk_rotation": 12.0}),
    "head to the front": ({"Neck": 10.0 * X, "Head": 20.0 * X}, {"neck_flexion": 30.0}),
    "head to the left": ({"Head": 40.0 * Z}, {"neck_rotation": 40.0}),
    "thigh to the front": (both("UpLeg", -60.0 * X), {"hip_flexion": 60.0}),
    "thigh outwards": (both("UpLeg", -30.0 * Y), {"hip_adduction": -30.0}),
    "toes inwards": (both("UpLeg", -20.0 * Z), {"hip_rotation": 20.0}),
    "knee": (both("Leg", 70.0 * X), {"knee_flexion": 70.0}),
    "toes up": (both("Foot", -15.0 * X), {"ankle_dorsiflexion": 15.0}),
    "soles inwards": (both("Foot", 10.0 * Y), {"subtalar_inversion": 10.0}),
    "feet inwards": (both("Foot", -12.0 * Z), {"ankle_rotation": 12.0}),
    "elbow": (both("ForeArm", -80.0 * Z), {"elbow_flexion": 80.0}),
    "palms to the front": (both("Hand", -90.0 * X), {"forearm_pronation": 0.0}),
    "palms to the forearm": (both("Hand", 30.0 * Y), {"wrist_flexion": 30.0}),
    "hands to the little finger": (both("Hand", 15.0 * Z), {"wrist_deviation": 15.0}),
    "arms hang": (
        HANGING,
        {"shoulder_adduction": 0.0, "shoulder_flexion": 0.0, "shoulder_rotation": 0.0, "shoulder_elevation": 0.0},
    ),
    "arms to the front": (
        both("Arm", turned(90.0 * Y, -90.0 * X)),
        {"shoulder_flexion": 90.0, "shoulder_adduction": 0.0, "shoulder_rotation": 0.0, "shoulder_elevation": 90.0,
         "shoulder_plane": 90.0, "shoulder_axial": -90.0},
    ),
    "hanging arms turned inwards": (
        both("Arm", turned(90.0 * Y, -35.0 * Z)),
        {"shoulder_rotation": 35.0, "shoulder_adduction": 0.0, "shoulder_flexion": 0.0, "shoulder_elevation": 0.0},
    ),
    "arms half raised aside": (both("Arm", 45.0 * Y), {"shoulder_elevation": 45.0, "shoulder_adduction": -45.0}),
}  # fmt: skip
T_POSE = {"pelvis_rotation": -90.0, "shoulder_adduction": -90.0, "shoulder_elevation": 90.0, "forearm_pronation": 90.0}
# Of the T-pose, flexion and rotation are locked; of a hanging arm, plane and axial rotation.
LOCKED = {"T": ("shoulder_flexion", "shoulder_rotation"), "hanging": ("shoulder_plane", "shoulder_axial")}


def free(name: str, found: dict[str, float]) -> bool:
    kind = name.removeprefix("left_").removeprefix("right_")
    side = name[: -len(kind)]
    raised_deg = found[f"{side or 'left_'}shoulder_elevation"]
    return not (
        (abs(raised_deg - 90.0) < 1e-6 and abs(found[f"{side or 'left_'}shoulder_adduction"]) > 89.0
         and kind in LOCKED["T"])
        or (abs(raised_deg) < 1e-6 and kind in LOCKED["hanging"])
    )  # fmt: skip


@pytest.mark.parametrize("pose", POSES)
def test_poses_have_angles_of_their_names_on_both_sides(pose: str) -> None:
    turns_deg, named_deg = POSES[pose]
    found = angles_deg(turns_deg)
    for name, found_deg in found.items():
        kind = name.removeprefix("left_").removeprefix("right_")
        if free(name, found):
            expected_deg = named_deg.get(kind, T_POSE.get(kind, 0.0))
            assert found_deg == pytest.approx(expected_deg, abs=1e-6), name


def test_arm_raised_aside_is_abducted_by_90_degrees() -> None:
    found = angles_deg({})
    for side in ("left", "right"):
        assert found[f"{side}_shoulder_adduction"] == pytest.approx(-90.0)
        assert found[f"{side}_shoulder_elevation"] == pytest.approx(90.0)
        assert found[f"{side}_shoulder_plane"] == pytest.approx(0.0)


def test_single_side_moves_no_angle_of_other() -> None:
    found = angles_deg({"RightUpLeg": -50.0 * X, "RightLeg": 90.0 * X})
    assert (found["right_hip_flexion"], found["right_knee_flexion"]) == pytest.approx((50.0, 90.0))
    assert (found["left_hip_flexion"], found["left_knee_flexion"]) == pytest.approx((0.0, 0.0))


def test_segment_frames_are_rotations_at_joints_of_body() -> None:
    body = {joint.name for joint in SKELETON}
    for segment in SEGMENTS.values():
        axes = segment.rest_from_segment
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(axes) == pytest.approx(1.0)
        assert segment.joint in body
    assert len(set(ANGLE_NAMES)) == len(ANGLE_NAMES) == 43
    for joint in JOINTS:
        assert all(angle.rotation < 3 and abs(angle.sign) == 1.0 for angle in joint.angles)


SEQUENCES: list[Sequence] = sorted({joint.sequence for joint in JOINTS} | {(0, 1, 2), (2, 1, 0), (2, 1, 2), (0, 2, 0)})


def name_of(sequence: Sequence) -> str:
    return "".join("XYZ"[axis] for axis in sequence)


@pytest.mark.parametrize("sequence", SEQUENCES, ids=name_of)
def test_angles_make_rotation_again(sequence: Sequence) -> None:
    rotation = Rotation.random(500, np.random.default_rng(3)).as_matrix()
    found_rad = angles_rad(rotation, sequence)
    np.testing.assert_allclose(Rotation.from_euler(name_of(sequence), found_rad).as_matrix(), rotation, atol=1e-9)
    is_proper = sequence[0] == sequence[2]
    low_deg, high_deg = (-180.0, 0.0) if is_proper else (-90.0, 90.0)
    assert (np.degrees(found_rad[:, 1]) >= low_deg).all()
    assert (np.degrees(found_rad[:, 1]) <= high_deg).all()


def test_mirror_keeps_rotations_about_axis_to_right() -> None:
    turned = Rotation.from_euler("ZXY", [[0.3, 0.2, -0.4]]).as_matrix()
    np.testing.assert_allclose(angles_rad(mirrored(turned), (2, 0, 1)), [[0.3, -0.2, 0.4]], atol=1e-12)


def test_arm_raised_overhead_is_abducted_beyond_90_degrees() -> None:
    raised_deg = np.linspace(0.0, 170.0, 60)
    rotation = Rotation.from_euler("ZXY", np.stack([0 * raised_deg + 2.0, -raised_deg, 0 * raised_deg], -1), True)
    found_deg = np.degrees(continuous(angles_rad(rotation.as_matrix(), (2, 0, 1)), is_proper=False))
    np.testing.assert_allclose(found_deg[:, 1], -raised_deg, atol=1e-6)
    np.testing.assert_allclose(found_deg[:, 0], 2.0, atol=1e-6)


def test_turns_in_circle_add_up() -> None:
    turn_deg = np.linspace(0.0, 1000.0, 300)
    rotation = Rotation.from_euler("ZXY", np.stack([turn_deg, 0 * turn_deg + 20.0, 0 * turn_deg + 5.0], -1), True)
    found_deg = np.degrees(continuous(angles_rad(rotation.as_matrix(), (2, 0, 1)), is_proper=False))
    np.testing.assert_allclose(found_deg[:, 0], turn_deg, atol=1e-6)
    proper = Rotation.from_euler("YXY", np.stack([turn_deg, 0 * turn_deg - 20.0, -turn_deg], -1), True)
    found_deg = np.degrees(continuous(angles_rad(proper.as_matrix(), (1, 0, 1)), is_proper=True))
    np.testing.assert_allclose(found_deg[:, 0], turn_deg, atol=1e-6)


def test_smooth_rotations_have_smooth_angles_away_from_locks() -> None:
    rng = np.random.default_rng(5)
    steps = Rotation.from_rotvec(rng.normal(0.0, 0.04, (2000, 3)))
    turning = [Rotation.identity()]
    for step in steps:
        turning.append(turning[-1] * step)
    rotation = np.array([turn.as_matrix() for turn in turning])
    locked = is_locked(rotation, (2, 0, 1))
    found_rad = continuous(angles_rad(rotation, (2, 0, 1)), is_proper=False)
    np.testing.assert_allclose(Rotation.from_euler("ZXY", found_rad).as_matrix(), rotation, atol=1e-9)
    free = ~(locked[1:] | locked[:-1])
    assert locked.any()
    assert np.abs(np.diff(found_rad, axis=0))[free].max() < 1.0


def test_gaps_stay_unknown_and_nothing_jumps_after_them() -> None:
    turn_deg = np.linspace(100.0, 300.0, 50)
    rotation = Rotation.from_euler("ZXY", np.stack([turn_deg, 0 * turn_deg, 0 * turn_deg], -1), True).as_matrix()
    rotation[20:25] = np.nan
    found_deg = np.degrees(continuous(angles_rad(rotation, (2, 0, 1)), is_proper=False))[:, 0]
    assert np.isnan(found_deg[20:25]).all()
    np.testing.assert_allclose(np.delete(found_deg, range(20, 25)), np.delete(turn_deg, range(20, 25)), atol=1e-6)


def test_nothing_known_is_nothing_found() -> None:
    assert np.isnan(continuous(np.full((4, 3), np.nan), is_proper=False)).all()
    assert continuous(np.empty((0, 3)), is_proper=True).shape == (0, 3)
