from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bvh_converter.bvhplayer_skeleton import process_bvhfile
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pipeline.config import Preset
from pipeline.data.animation import SkeletonMotion
from pipeline.export.presets import PRESETS
from pipeline.export.writers import bvh
from pipeline.joints import COCO_17
from pipeline.skeleton.fitting.fit import SkeletonFit
from pipeline.skeleton.model import (
    INDEX,
    SKELETON,
    WHOLE_SKELETON,
    SkeletonJoint,
    children_of,
    forward_kinematics,
    skeleton_of,
)
from tests.pipeline.export.bvh_readers import bvhio, read_with_bvh_converter, read_with_bvhio
from tests.pipeline.skeleton.synthetic_tracks import timebase, track_of, walker

TOLERANCE_CM = 0.1
NTSC_HZ = 30000 / 1001


def walk(num_frames: int = 50, frame_rate_hz: float = NTSC_HZ) -> SkeletonMotion:
    xyz_m = walker(num_frames, frame_rate_hz, turn_rad=2 * np.pi)
    xyz_m += np.random.default_rng(0).normal(scale=0.02, size=xyz_m.shape)
    return SkeletonFit(track_of(xyz_m), COCO_17, timebase(num_frames, frame_rate_hz), "person-1").motion()


def with_fingers(motion: SkeletonMotion) -> SkeletonMotion:
    """Add hands that open and close: each joint of a finger turns by an angle of its own about all axes."""
    num_frames, fingers = len(motion.root_m), WHOLE_SKELETON[len(SKELETON) :]
    stature_m = motion.bone_length_m[INDEX["Head"]] / SKELETON[INDEX["Head"]].stature_share
    phase = np.linspace(0.0, 2.0 * np.pi, num_frames)[:, None, None] + np.arange(3 * len(fingers)).reshape(-1, 3)
    turns = Rotation.from_rotvec(0.4 * np.sin(phase).reshape(-1, 3)).as_quat().reshape(num_frames, -1, 4)
    turns[:, [not children_of(64)[joint.name] for joint in fingers]] = [0.0, 0.0, 0.0, 1.0]
    return replace(
        motion,
        bone_length_m=np.append(motion.bone_length_m, [stature_m * joint.stature_share for joint in fingers]),
        parent_from_joint=np.concatenate([motion.parent_from_joint, turns], axis=1),
    )


MOTIONS = pytest.mark.parametrize("dressed", [lambda motion: motion, with_fingers], ids=["body", "fingers"])


def positions_cm(motion: SkeletonMotion) -> np.ndarray:
    """Expected positions: x, y, z of BVH are the world's x, z, -y in centimetres."""
    x, y, z = np.moveaxis(forward_kinematics(motion), -1, 0)
    return 100.0 * np.stack([x, z, -y], axis=-1)


def encoded(motion: SkeletonMotion, preset: Preset = "default") -> bytes:
    return b"".join(bvh.encode(motion, PRESETS[preset]))


def parse(content: bytes) -> tuple[float, np.ndarray, np.ndarray]:
    """Read a BVH file: frame time, positions (frames, joints, 3) and rest positions (joints, 3)."""
    header, motion = content.decode("ascii").split("MOTION\n")
    num_frames, frame_time, *rows = motion.splitlines()
    values = np.array([row.split() for row in rows], dtype=float)
    assert num_frames == f"Frames: {len(values)}"
    num_joints = header.count("OFFSET")
    positions = np.zeros((len(values), num_joints, 3))
    rest = np.zeros((num_joints, 3))
    stack: list[tuple[str, Rotation]] = []
    column, name = 0, ""
    for line in header.splitlines():
        match line.split():
            case [("ROOT" | "JOINT"), name]:
                pass
            case ["End", "Site"]:
                name = f"{stack[-1][0]}End"
            case ["OFFSET", *offset]:
                offset_cm = np.array(offset, dtype=float)
                if stack:
                    parent, rotation = stack[-1]
                    positions[:, INDEX[name]] = positions[:, INDEX[parent]] + rotation.apply(offset_cm)
                    rest[INDEX[name]] = rest[INDEX[parent]] + offset_cm
                stack.append((name, Rotation.identity(len(values))))
            case ["CHANNELS", count, *channels]:
                assert channels[-3:] == ["Zrotation", "Xrotation", "Yrotation"]
                if count == "6":
                    positions[:, 0] = values[:, :3]
                    column = 3
                rotation = Rotation.from_euler("ZXY", values[:, column : column + 3], degrees=True)
                column += 3
                stack[-1] = (name, stack[-2][1] * rotation if len(stack) > 1 else rotation)
            case ["}"]:
                stack.pop()
    assert column == values.shape[1]
    return float(frame_time.removeprefix("Frame Time: ")), positions, rest


@MOTIONS
@pytest.mark.parametrize("read", [read_with_bvhio, read_with_bvh_converter])
def test_other_readers_find_the_same_positions(
    tmp_path: Path,
    read: Callable[[Path], dict[str, np.ndarray]],
    dressed: Callable[[SkeletonMotion], SkeletonMotion],
) -> None:
    motion = dressed(walk())
    path = tmp_path / "person.bvh"
    path.write_bytes(encoded(motion))
    expected_cm = positions_cm(motion)
    found = read(path)
    names = {joint.name for joint in skeleton_of(len(motion.bone_length_m))}
    assert {name for name in names if not name.endswith("End")} <= set(found) <= names
    for name, found_cm in found.items():
        assert found_cm.shape == (50, 3)
        assert np.linalg.norm(found_cm - expected_cm[:, INDEX[name]], axis=-1).max() < TOLERANCE_CM, name


def test_fingers_leave_the_lines_of_the_body_as_they_are() -> None:
    body, whole = encoded(walk(3)).decode().split("MOTION\n"), encoded(with_fingers(walk(3))).decode().split("MOTION\n")
    # Lines of the body, in their order, are a part of the hierarchy with fingers.
    lines = iter(whole[0].splitlines())
    assert all(line in lines for line in body[0].splitlines())
    assert whole[0].count("JOINT") == body[0].count("JOINT") + 30
    assert "JOINT LeftHandThumb1\n" in whole[0]


def test_other_readers_find_the_frame_rate(tmp_path: Path) -> None:
    path = tmp_path / "person.bvh"
    path.write_bytes(encoded(walk()))
    assert bvhio.readAsBvh(str(path)).FrameTime == pytest.approx(1 / NTSC_HZ, abs=1e-15)
    assert process_bvhfile(str(path)).dt == pytest.approx(1 / NTSC_HZ, abs=1e-15)


def test_bvhio_finds_an_upright_t_pose(tmp_path: Path) -> None:
    path = tmp_path / "person.bvh"
    path.write_bytes(encoded(walk(1)))
    root = bvhio.readAsHierarchy(str(path)).loadRestPose(recursive=True)
    at = {joint.Name: np.array(joint.PositionWorld) for joint, _, _ in root.layout()}
    assert at["Head"][1] > at["Hips"][1] + 60 > at["LeftFoot"][1] + 130
    np.testing.assert_allclose(at["LeftHand"][1:], at["Neck"][1:], atol=0.05)
    np.testing.assert_allclose(at["RightHand"], at["LeftHand"] * [-1, 1, 1], atol=0.05)
    assert at["LeftHand"][0] > 60


# Right angles make gimbal lock likely.
angles_deg = st.one_of(st.floats(-200, 200), st.sampled_from([-180.0, -90.0, 0.0, 90.0, 180.0]))


@settings(max_examples=60, deadline=None)
@given(st.data(), st.integers(1, 4), st.sampled_from([SKELETON, WHOLE_SKELETON]))
def test_rotations_survive_the_file(data: st.DataObject, num_frames: int, skeleton: tuple[SkeletonJoint, ...]) -> None:
    size = num_frames * len(skeleton) * 3
    # A few drawn angles everywhere cover more than a list as long as the body.
    drawn = data.draw(st.lists(angles_deg, min_size=1, max_size=12))
    euler = np.resize(drawn, size).reshape(-1, 3)
    motion = SkeletonMotion(
        track_id=1,
        name="person-1",
        start_frame=0,
        frame_rate_hz=25.0,
        bone_length_m=np.array([1.8 * joint.stature_share for joint in skeleton]),
        root_m=np.resize(drawn, num_frames * 3).reshape(-1, 3) / 50.0,
        parent_from_joint=Rotation.from_euler("YXZ", euler, degrees=True).as_quat().reshape(num_frames, -1, 4),
        contacts=(),
    )
    frame_time_s, read_cm, rest_cm = parse(encoded(motion))
    assert frame_time_s == 0.04
    assert np.abs(read_cm - positions_cm(motion)).max() < TOLERANCE_CM
    assert rest_cm[INDEX["HeadEnd"], 1] > 80
    assert rest_cm[INDEX["LeftFootEnd"], 2] > 10


def test_angles_are_continuous_through_gimbal_lock_and_full_turns() -> None:
    steps = np.linspace(0, 1, 181)
    over_the_top = np.column_stack([0 * steps + 20, 360 * steps - 180, 30 * steps])
    around = np.column_stack([720 * steps, 10 * np.sin(9 * steps), -400 * steps])
    truth = np.stack([over_the_top, around], axis=1)
    matrices = Rotation.from_euler("ZXY", truth.reshape(-1, 3), degrees=True).as_matrix().reshape(181, 2, 3, 3)
    angles = bvh.euler_deg(matrices, "ZXY", np.zeros((2, 3)))
    assert np.abs(np.diff(angles, axis=0)).max() < 6.0
    again = Rotation.from_euler("ZXY", angles.reshape(-1, 3), degrees=True).as_matrix().reshape(181, 2, 3, 3)
    np.testing.assert_allclose(again, matrices, atol=1e-6)


def test_the_same_motion_gives_the_same_bytes_without_negative_zeros() -> None:
    content = encoded(walk(5))
    assert content == encoded(walk(5))
    assert b"-0.0000 " not in content
    assert b"-0.00 " not in content
    assert content.endswith(b"\n")
    assert b"nan" not in content


def test_frame_time_has_full_precision() -> None:
    for frame_rate_hz in (25.0, 29.97, NTSC_HZ, 59.94, 240.0):
        assert parse(encoded(walk(1, frame_rate_hz)))[0] == 1.0 / frame_rate_hz
