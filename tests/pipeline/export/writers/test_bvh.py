from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bvh_converter.bvhplayer_skeleton import process_bvhfile
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.joints import COCO_17
from pipeline.core.options.config import Preset
from pipeline.export.presets import PRESETS, Convention
from pipeline.export.writers import bvh
from pipeline.export.writers.euler import euler_deg
from pipeline.export.writers.rotation_orders import rotation_orders
from pipeline.motion.skeleton.fitting.fit import SkeletonFit
from pipeline.motion.skeleton.model import (
    INDEX,
    SKELETON,
    WHOLE_SKELETON,
    SkeletonJoint,
    child_names,
    find_skeleton,
    forward_kinematics,
)
from tests.pipeline.export.blender_curves import positions_in_blender
from tests.pipeline.export.bvh_readers import bvhio, read_with_bvh_converter, read_with_bvhio
from tests.pipeline.motion.skeleton.synthetic_tracks import timebase, track_of, walker

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
    turns[:, [not child_names(64)[joint.name] for joint in fingers]] = [0.0, 0.0, 0.0, 1.0]
    return replace(
        motion,
        bone_length_m=np.append(motion.bone_length_m, [stature_m * joint.stature_share for joint in fingers]),
        parent_from_joint=np.concatenate([motion.parent_from_joint, turns], axis=1),
    )


def tumbling(num_frames: int = 60, frame_rate_hz: float = 50.0) -> SkeletonMotion:
    """Body that turns on its back and lifts a stretched leg: hips and thigh are in gimbal lock of Z X Y."""
    turn = np.linspace(0.0, 1.5 * np.pi, num_frames)
    quat_xyzw = np.tile([0.0, 0.0, 0.0, 1.0], (num_frames, len(SKELETON), 1))
    # World axes: about X the body lies down, about Z it turns on the floor.
    lying = Rotation.from_rotvec(np.column_stack([np.radians(-88.0 - 3.0 * np.sin(3.0 * turn)), 0 * turn, 0 * turn]))
    quat_xyzw[:, 0] = (Rotation.from_rotvec(turn[:, None] * [0.0, 0.0, 1.0]) * lying).as_quat()
    raised = np.column_stack([-1.5 + 0.3 * np.sin(turn), 0.4 * np.cos(turn), 0.5 * turn])
    quat_xyzw[:, INDEX["LeftUpLeg"]] = Rotation.from_euler("XYZ", raised).as_quat()
    return SkeletonMotion(
        track_id=1,
        name="person-1",
        start_frame=100,
        frame_rate_hz=frame_rate_hz,
        bone_length_m=np.array([1.8 * joint.stature_share for joint in SKELETON]),
        root_m=np.column_stack([np.cos(turn), np.sin(turn), 0.2 + 0 * turn]),
        parent_from_joint=quat_xyzw,
        contacts=(),
    )


def orders_in(content: bytes) -> dict[str, str]:
    """Axes of the rotations of each joint of a file, in order."""
    name, orders = "", {}
    for line in content.decode("ascii").splitlines():
        match line.split():
            case [("ROOT" | "JOINT"), name]:
                pass
            case ["CHANNELS", _, *channels]:
                orders[name] = "".join(channel[0] for channel in channels[-3:])
    return orders


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
                assert sorted(channels[-3:]) == ["Xrotation", "Yrotation", "Zrotation"]
                axes = "".join(channel[0] for channel in channels[-3:])
                if count == "6":
                    positions[:, 0] = values[:, :3]
                    column = 3
                rotation = Rotation.from_euler(axes, values[:, column : column + 3], degrees=True)
                column += 3
                stack[-1] = (name, stack[-2][1] * rotation if len(stack) > 1 else rotation)
            case ["}"]:
                stack.pop()
    assert column == values.shape[1]
    return float(frame_time.removeprefix("Frame Time: ")), positions, rest


@MOTIONS
@pytest.mark.parametrize("read", [read_with_bvhio, read_with_bvh_converter])
def test_other_readers_find_same_positions(
    tmp_path: Path,
    read: Callable[[Path], dict[str, np.ndarray]],
    dressed: Callable[[SkeletonMotion], SkeletonMotion],
) -> None:
    motion = dressed(walk())
    path = tmp_path / "person.bvh"
    path.write_bytes(encoded(motion))
    expected_cm = positions_cm(motion)
    found = read(path)
    names = {joint.name for joint in find_skeleton(len(motion.bone_length_m))}
    assert {name for name in names if not name.endswith("End")} <= set(found) <= names
    for name, found_cm in found.items():
        assert found_cm.shape == (50, 3)
        assert np.linalg.norm(found_cm - expected_cm[:, INDEX[name]], axis=-1).max() < TOLERANCE_CM, name


@pytest.mark.parametrize("read", [read_with_bvhio, read_with_bvh_converter])
def test_other_readers_read_order_for_each_joint(tmp_path: Path, read: Callable[[Path], dict[str, np.ndarray]]) -> None:
    motion = tumbling()
    path = tmp_path / "person.bvh"
    path.write_bytes(encoded(motion))
    assert len(set(orders_in(encoded(motion)).values())) > 1
    for name, found_cm in read(path).items():
        assert np.linalg.norm(found_cm - positions_cm(motion)[:, INDEX[name]], axis=-1).max() < TOLERANCE_CM, name


def test_fingers_leave_lines_of_body_as_they_are() -> None:
    body, whole = encoded(walk(3)).decode().split("MOTION\n"), encoded(with_fingers(walk(3))).decode().split("MOTION\n")
    # Lines of the body, in their order, are a part of the hierarchy with fingers.
    lines = iter(whole[0].splitlines())
    assert all(line in lines for line in body[0].splitlines())
    assert whole[0].count("JOINT") == body[0].count("JOINT") + 30
    assert "JOINT LeftHandThumb1\n" in whole[0]


def test_other_readers_find_frame_rate(tmp_path: Path) -> None:
    path = tmp_path / "person.bvh"
    path.write_bytes(encoded(walk()))
    assert bvhio.readAsBvh(str(path)).FrameTime == pytest.approx(1 / NTSC_HZ, abs=1e-15)
    assert process_bvhfile(str(path)).dt == pytest.approx(1 / NTSC_HZ, abs=1e-15)


def test_bvhio_finds_upright_t_pose(tmp_path: Path) -> None:
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
def test_rotations_survive_file(data: st.DataObject, num_frames: int, skeleton: tuple[SkeletonJoint, ...]) -> None:
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


def test_angles_through_gimbal_lock_and_turns_are_continuous() -> None:
    steps = np.linspace(0, 1, 181)
    over_the_top = np.column_stack([0 * steps + 20, 360 * steps - 180, 30 * steps])
    around = np.column_stack([720 * steps, 10 * np.sin(9 * steps), -400 * steps])
    truth = np.stack([over_the_top, around], axis=1)
    matrices = Rotation.from_euler("ZXY", truth.reshape(-1, 3), degrees=True).as_matrix().reshape(181, 2, 3, 3)
    angles = euler_deg(matrices, ["ZXY", "ZXY"], np.zeros((2, 3)))
    assert np.abs(np.diff(angles, axis=0)).max() < 6.0
    again = Rotation.from_euler("ZXY", angles.reshape(-1, 3), degrees=True).as_matrix().reshape(181, 2, 3, 3)
    np.testing.assert_allclose(again, matrices, atol=1e-6)


def test_equal_motions_give_equal_bytes_without_negative_zeros() -> None:
    content = encoded(walk(5))
    assert content == encoded(walk(5))
    assert b"-0.0000 " not in content
    assert b"-0.00 " not in content
    assert content.endswith(b"\n")
    assert b"nan" not in content


def test_frame_time_has_full_precision() -> None:
    for frame_rate_hz in (25.0, 29.97, NTSC_HZ, 59.94, 240.0):
        assert parse(encoded(walk(1, frame_rate_hz)))[0] == 1.0 / frame_rate_hz


ONE_ORDER = replace(PRESETS["default"], is_order_demanded=True)


def half_way_of(motion: SkeletonMotion) -> SkeletonMotion:
    """Motion half-way between frames, where rotations take the shortest arcs."""
    steps = np.arange(len(motion.root_m))
    turns = [
        Slerp(steps, Rotation.from_quat(quat))(steps[:-1] + 0.5) for quat in motion.parent_from_joint.swapaxes(0, 1)
    ]
    return replace(
        motion,
        root_m=(motion.root_m[1:] + motion.root_m[:-1]) / 2,
        parent_from_joint=np.stack([turn.as_quat() for turn in turns], axis=1),
    )


def between_frames_mm(motion: SkeletonMotion, convention: Convention = PRESETS["default"]) -> np.ndarray:
    """Distance of each joint half-way between two frames, (frames - 1, joints): in Blender, and by shortest arcs."""
    found = positions_in_blender(b"".join(bvh.encode(motion, convention)), half_way=True)
    expected = convention.file_from_xyz_m(forward_kinematics(half_way_of(motion)))
    apart = [
        np.linalg.norm(found[convention.name(joint.name)] - expected[:, index], axis=-1)
        for index, joint in enumerate(find_skeleton(expected.shape[1]))
        if convention.name(joint.name) in found
    ]
    return 1e3 / convention.units_per_m * np.stack(apart, axis=1)


def about_the_lock(axis: str, num_frames: int = 60) -> SkeletonMotion:
    """Body whose left thigh swings by 90 degrees about an axis of the world, and turns there about the others."""
    phase = np.linspace(0.0, 2.0 * np.pi, num_frames)
    turns = np.column_stack([np.pi / 2 + 0.2 * np.sin(phase), 0.6 * np.cos(phase), 0.4 * np.sin(2.0 * phase)])
    motion = tumbling(num_frames)
    quat_xyzw = np.tile([0.0, 0.0, 0.0, 1.0], (num_frames, len(SKELETON), 1))
    axes = axis + "XYZ".replace(axis, "")
    quat_xyzw[:, INDEX["LeftUpLeg"]] = Rotation.from_euler(axes, turns).as_quat()
    quat_xyzw[:, INDEX["RightArm"]] = Rotation.from_euler(axes, turns).as_quat()
    return replace(motion, parent_from_joint=quat_xyzw)


@pytest.mark.parametrize("preset", [preset for preset in PRESETS if preset != "unity-humanoid"])
def test_bvh_of_turning_body_in_blender_stays_near_motion(preset: Preset) -> None:
    motion = tumbling()
    assert between_frames_mm(motion, PRESETS[preset]).max() < 1.0


@pytest.mark.parametrize("axis", ["X", "Y", "Z"])
def test_bvh_of_limbs_at_90_degrees_in_blender_stays_near(axis: str) -> None:
    motion = about_the_lock(axis)
    for convention in (PRESETS["default"], PRESETS["unreal"]):
        assert between_frames_mm(motion, convention).max() < 3.0


def test_bvh_in_one_order_in_blender_is_off() -> None:
    motion = tumbling()
    assert 2.0 < between_frames_mm(motion, ONE_ORDER).max() < 3.0
    orders = orders_in(encoded(motion))
    assert orders["LeftUpLeg"] != "ZXY"
    # Joints whose angles are not off keep the usual order.
    assert orders["RightUpLeg"] == orders["Head"] == "ZXY"
    assert encoded(motion) == encoded(motion)


def test_people_who_walk_have_one_order_in_all_joints() -> None:
    motion = SkeletonFit(track_of(walker(100, 50.0)), COCO_17, timebase(100, 50.0), "person-1").motion()
    assert set(orders_in(encoded(motion)).values()) == {"ZXY"}
    assert between_frames_mm(motion).max() < 2.0


CONVENTIONS = {"orders by joint": PRESETS["default"], "one order": ONE_ORDER, "arms lowered": PRESETS["unreal"]}


@pytest.mark.parametrize("convention", CONVENTIONS.values(), ids=CONVENTIONS)
def test_place_where_interpolated_angles_are_off_is_found(convention: Convention) -> None:
    motion = tumbling(700)  # more than a block of frames
    apart_mm = between_frames_mm(motion, convention)
    between = rotation_orders(motion, convention, "Blender").between
    assert between is not None
    assert between.program == "Blender"
    assert between.distance_mm == pytest.approx(apart_mm.max(), abs=0.05)
    assert apart_mm[between.frame - motion.start_frame].max() == pytest.approx(apart_mm.max(), abs=0.05)
    assert between.joint in {"Hips", "LeftUpLeg"}


def test_single_frame_has_nothing_between_frames() -> None:
    motion = tumbling(1)
    assert rotation_orders(motion, PRESETS["default"], "Blender").between is None
    assert set(orders_in(encoded(motion)).values()) == {"ZXY"}
