"""Export presets: names, axes, unit and rest pose, read by bvhio."""

from itertools import product
from pathlib import Path

import numpy as np
import pytest

from pipeline.core.options.config import Preset
from pipeline.export.presets import PRESETS
from pipeline.export.writers import bvh
from pipeline.motion.skeleton.model import SKELETON, WHOLE_SKELETON, find_skeleton, forward_kinematics
from tests.cases import slow_but
from tests.pipeline.export.bvh_readers import bvhio, read_with_bvhio
from tests.pipeline.export.writers.test_bvh import encoded, orders_in, tumbling, walk, with_fingers

SOME_NAMES: dict[Preset, set[str]] = {
    "default": {"Hips", "Chest", "LeftArm", "RightForeArm", "LeftUpLeg", "RightFoot"},
    "blender": {"hips", "chest", "upper_arm.L", "forearm.R", "thigh.L", "foot.R"},
    "unity-humanoid": {"Hips", "Chest", "LeftUpperArm", "RightLowerArm", "LeftUpperLeg", "RightFoot"},
    "unreal": {"pelvis", "spine_03", "upperarm_l", "lowerarm_r", "thigh_l", "foot_r"},
    "humanik": {"Hips", "Spine1", "LeftArm", "RightForeArm", "LeftUpLeg", "RightFoot"},
    "mixamo": {f"mixamorig:{name}" for name in ("Hips", "Spine2", "LeftArm", "RightForeArm", "LeftUpLeg", "RightFoot")},
}


# Joints of a thumb and of a little finger from the palm.
FINGERS: dict[Preset, list[str]] = {
    "default": ["LeftHandThumb1", "LeftHandThumb2", "LeftHandThumb3", "RightHandPinky1", "RightHandPinky3"],
    "blender": ["thumb.01.L", "thumb.02.L", "thumb.03.L", "f_pinky.01.R", "f_pinky.03.R"],
    "unity-humanoid": [
        "LeftThumbProximal",
        "LeftThumbIntermediate",
        "LeftThumbDistal",
        "RightLittleProximal",
        "RightLittleDistal",
    ],
    "unreal": ["thumb_01_l", "thumb_02_l", "thumb_03_l", "pinky_01_r", "pinky_03_r"],
    "humanik": ["LeftHandThumb1", "LeftHandThumb2", "LeftHandThumb3", "RightHandPinky1", "RightHandPinky3"],
    "mixamo": [
        "mixamorig:LeftHandThumb1",
        "mixamorig:LeftHandThumb2",
        "mixamorig:LeftHandThumb3",
        "mixamorig:RightHandPinky1",
        "mixamorig:RightHandPinky3",
    ],
}


def rest(preset: Preset, path: Path) -> dict[str, np.ndarray]:
    """Rest positions in metres by Multicap's joint names."""
    path.write_bytes(encoded(walk(1), preset))
    root = bvhio.readAsHierarchy(str(path)).loadRestPose(recursive=True)
    found = {joint.Name: np.array(joint.PositionWorld) for joint, _, _ in root.layout()}
    assert SOME_NAMES[preset] <= set(found)
    assert len(found) == 19
    convention = PRESETS[preset]
    return {
        joint.name: found[convention.name(joint.name)] / convention.units_per_m
        for joint in SKELETON
        if convention.name(joint.name) in found
    }


@pytest.mark.parametrize("preset", PRESETS)
def test_rest_pose_stands_upright_and_faces_right_way(preset: Preset, tmp_path: Path) -> None:
    at = rest(preset, tmp_path / "person.bvh")
    up, forward = (2, np.array([0, -1, 0])) if preset == "unreal" else (1, np.array([0, 0, 1]))
    assert at["Head"][up] - at["Hips"][up] == pytest.approx(0.60, abs=0.15)
    assert at["Hips"][up] - at["LeftFoot"][up] == pytest.approx(0.82, abs=0.05)
    left = at["LeftArm"] - at["RightArm"]
    np.testing.assert_allclose(np.cross(left, np.eye(3)[up]) / np.linalg.norm(left), forward, atol=1e-6)


@pytest.mark.parametrize("preset", PRESETS)
def test_arms_are_stretched_out_or_lowered(preset: Preset, tmp_path: Path) -> None:
    at = rest(preset, tmp_path / "person.bvh")
    up = 2 if preset == "unreal" else 1
    for side in ("Left", "Right"):
        arm = at[f"{side}Hand"] - at[f"{side}Arm"]
        below_deg = np.degrees(np.arcsin(-arm[up] / np.linalg.norm(arm)))
        assert below_deg == pytest.approx(45.0 if preset == "unreal" else 0.0, abs=0.05)


@pytest.mark.parametrize("preset", PRESETS)
def test_fingers_have_names_of_target_software(preset: Preset) -> None:
    convention = PRESETS[preset]
    ours = ["LeftHandThumb1", "LeftHandThumb2", "LeftHandThumb3", "RightHandPinky1", "RightHandPinky3"]
    assert [convention.name(name) for name in ours] == FINGERS[preset]
    assert len({convention.name(joint.name) for joint in WHOLE_SKELETON}) == len(WHOLE_SKELETON)


def test_mixamo_numbers_ends_of_fingers() -> None:
    assert PRESETS["mixamo"].name("LeftHandIndex3End") == "mixamorig:LeftHandIndex4"


@pytest.mark.parametrize(
    ("preset", "has_fingers"),
    slow_but([("default", True), ("unreal", False), ("unity-humanoid", True)], product(PRESETS, (False, True))),
)
def test_our_own_reader_agrees_with_another(preset: Preset, has_fingers: bool, tmp_path: Path) -> None:
    motion = walk(200, frame_rate_hz=119.88)
    motion = with_fingers(motion) if has_fingers else motion
    path = tmp_path / "person.bvh"
    path.write_bytes(encoded(motion, preset))
    own_m = np.concatenate(list(bvh.read_xyz_m(path, PRESETS[preset])))
    np.testing.assert_allclose(own_m, forward_kinematics(motion), atol=2e-4)
    found = read_with_bvhio(path)
    for index, joint in enumerate(find_skeleton(own_m.shape[1])):
        if not joint.name.endswith("End"):
            expected = PRESETS[preset].file_from_xyz_m(own_m[:, index])
            other = found[PRESETS[preset].name(joint.name)]
            assert np.abs(other - expected).max() < 2e-4 * PRESETS[preset].units_per_m


@pytest.mark.parametrize("preset", PRESETS)
def test_our_own_reader_reads_order_for_each_joint(preset: Preset, tmp_path: Path) -> None:
    motion = tumbling()
    path = tmp_path / "person.bvh"
    path.write_bytes(encoded(motion, preset))
    own_m = np.concatenate(list(bvh.read_xyz_m(path, PRESETS[preset])))
    np.testing.assert_allclose(own_m, forward_kinematics(motion), atol=2e-4)
    # Unity's plug-in turns about axes in one order.
    assert (len(set(orders_in(path.read_bytes()).values())) == 1) == (preset == "unity-humanoid")
