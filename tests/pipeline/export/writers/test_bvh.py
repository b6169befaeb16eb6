from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bvh_converter.bvhplayer_skeleton import process_bvhfile
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pipeline.config import Preset
from pipeline.data import SkeletonMotion
from pipeline.export.presets import PRESETS
from pipeline.export.writers import bvh
from pipeline.joints import COCO_17
from pipeline.skeleton.fitting.fit import SkeletonFit
from pipeline.skeleton.model import INDEX, SKELETON, forward_kinematics
from tests.pipeline.export.bvh_readers import bvhio, read_with_bvh_converter, read_with_bvhio
from tests.pipeline.skeleton.synthetic_tracks import timebase, track_of, walker

TOLERANCE_CM = 0.1
NTSC_HZ = 30000 / 1001


def walk(num_frames: int = 50, frame_rate_hz: float = NTSC_HZ) -> SkeletonMotion:
    xyz_m = walker(num_frames, frame_rate_hz, turn_rad=2 * np.pi)
    xyz_m += np.random.default_rng(0).normal(scale=0.02, size=xyz_m.shape)
    return SkeletonFit(track_of(xyz_m), COCO_17, timebase(num_frames, frame_rate_hz), "person-1").motion()


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
    positions = np.zeros((len(values), len(SKELETON), 3))
    rest = np.zeros((len(SKELETON), 3))
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


@pytest.mark.parametrize("read", [read_with_bvhio, read_with_bvh_converter])
def test_other_readers_find_the_same_positions(tmp_path: Path, read: Callable[[Path], dict[str, np.ndarray]]) -> None:
    motion = walk()
    path = tmp_path / "person.bvh"
    path.write_bytes(encoded(motion))
    expected_cm = positions_cm(motion)
    found = read(path)
    assert {name for name in INDEX if not name.endswith("End")} <= set(found) <= set(INDEX)
    for name, found_cm in found.items():
        assert found_cm.shape == (50, 3)
        assert np.linalg.norm(found_cm - expected_cm[:, INDEX[name]], axis=-1).max() < TOLERANCE_CM, name


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
@given(st.data(), st.integers(1, 4))
def test_rotations_survive_the_file(data: st.DataObject, num_frames: int) -> None:
    size = num_frames * len(SKELETON) * 3
    # A few drawn angles everywhere cover more than a list as long as the body.
    drawn = data.draw(st.lists(angles_deg, min_size=1, max_size=12))
    euler = np.resize(drawn, size).reshape(-1, 3)
    motion = SkeletonMotion(
        track_id=1,
        name="person-1",
        start_frame=0,
        frame_rate_hz=25.0,
        bone_length_m=np.array([1.8 * joint.stature_share for joint in SKELETON]),
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
