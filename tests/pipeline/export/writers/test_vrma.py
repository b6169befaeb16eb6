"""VRMA files, played by ``@pixiv/three-vrm-animation`` on characters that are made here."""

import json
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import SkeletonMotion
from pipeline.export.presets import GLTF
from pipeline.export.writers import vrma
from pipeline.export.writers.body_mesh import CAPSULES, body_at_rest
from pipeline.motion.skeleton.model import INDEX, find_skeleton, forward_kinematics, parent_indices
from tests.e2e.foreign import play_on_vrm, validate_with_khronos
from tests.pipeline.export.writers.test_bvh import MOTIONS, walk, with_fingers

# Bones that a VRM must have.
REQUIRED = {
    "hips",
    "spine",
    "head",
    *(
        f"{side}{bone}"
        for side in ("left", "right")
        for bone in ("UpperArm", "LowerArm", "Hand", "UpperLeg", "LowerLeg", "Foot")
    ),
}


def character(path: Path, motion: SkeletonMotion, scale: float) -> Path:
    """Write a VRM with bones in proportion to a skeleton's, turned at random in their T-pose."""
    rest_m = scale * body_at_rest(motion, GLTF, CAPSULES).positions
    joints, parents = find_skeleton(len(rest_m)), parent_indices(len(rest_m))
    turns = Rotation.random(len(rest_m), rng=np.random.default_rng(1))
    nodes: list[dict[str, object]] = [{"name": "Root", "children": [1], "rotation": [0.0, 0.0, 0.0, 1.0]}]
    for index, joint in enumerate(joints):
        of_parent = turns[int(parents[index])] if index else Rotation.identity()
        above_m = rest_m[parents[index]] if index else np.zeros(3)
        nodes.append(
            {
                "name": f"骨 {index}",
                "translation": of_parent.inv().apply(rest_m[index] - above_m).tolist(),
                "rotation": (of_parent.inv() * turns[index]).as_quat().tolist(),
                "children": [1 + INDEX[child.name] for child in joints if child.parent == joint.name],
            }
        )
    for node in nodes:
        if not node["children"]:
            del node["children"]
    bones = {bone: {"node": 1 + INDEX[name]} for name, bone in vrma.HUMAN_BONES.items() if INDEX[name] < len(rest_m)}
    meta = {"name": "character", "authors": ["test"], "licenseUrl": "https://vrm.dev/licenses/1.0/"}
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": nodes,
        "extensionsUsed": ["VRMC_vrm"],
        "extensions": {"VRMC_vrm": {"specVersion": "1.0", "meta": meta, "humanoid": {"humanBones": bones}}},
    }
    head = json.dumps(document).encode()
    head += b" " * (-len(head) % 4)
    path.write_bytes(struct.pack("<4sIIII", b"glTF", 2, 20 + len(head), len(head), 0x4E4F534A) + head)
    return path


@pytest.mark.parametrize("scale", [1.0, pytest.param(0.6, marks=pytest.mark.slow)])
@MOTIONS
def test_character_moves_as_person_does(
    dressed: Callable[[SkeletonMotion], SkeletonMotion], scale: float, tmp_path: Path
) -> None:
    """Joints of a character in the person's proportions are within 0.1 mm, in places that are scaled with its legs."""
    motions = {
        tmp_path / f"{num_frames} at {rate_hz:.3f}.vrma": dressed(walk(num_frames, rate_hz))
        for num_frames, rate_hz in ((1, 25.0), (2, 120000 / 1001), (700, 30000 / 1001))
    }
    characters = {}
    for path, motion in motions.items():
        path.write_bytes(b"".join(vrma.encode(motion, np.zeros(3))))
        characters[path] = character(path.with_suffix(".vrm"), motion, scale)
    played = play_on_vrm(characters)
    for path, motion in motions.items():
        expected_m, found = forward_kinematics(motion), played[path]
        bones = {joint.name: vrma.HUMAN_BONES.get(joint.name) for joint in find_skeleton(expected_m.shape[1])}
        assert found.positions.keys() == {bone for bone in bones.values() if bone}
        for name, bone in bones.items():
            if bone:
                x, y, z = expected_m[:, INDEX[name]].T
                place_m = scale * np.column_stack([x, z, -y])
                np.testing.assert_allclose(found.positions[bone], place_m, atol=1e-4, err_msg=f"{path.name} {bone}")
        assert len(expected_m) == 1 or found.frame_rate_hz == pytest.approx(motion.frame_rate_hz, rel=1e-4)


@MOTIONS
def test_files_are_valid_and_read_back(dressed: Callable[[SkeletonMotion], SkeletonMotion], tmp_path: Path) -> None:
    paths = {tmp_path / f"{num_frames}.glb": dressed(walk(num_frames)) for num_frames in (1, 2, 600)}
    for path, motion in paths.items():
        path.write_bytes(b"".join(vrma.encode(motion, np.array([7.0, 0.0, 0.0]))))
        own_m = np.concatenate(list(vrma.read_xyz_m(path)))
        np.testing.assert_allclose(own_m, forward_kinematics(motion), atol=1e-5)
    for path, issues in validate_with_khronos(list(paths)).items():
        assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), (path, issues["messages"])


def stored(motion: SkeletonMotion) -> dict[str, Any]:
    content = b"".join(vrma.encode(motion, np.zeros(3)))
    document: dict[str, Any] = json.loads(content[20 : 20 + int.from_bytes(content[12:16], "little")])
    return document


def test_extension_names_each_bone_once() -> None:
    for motion, num_bones in ((walk(2), 19), (with_fingers(walk(2)), 49)):
        document = stored(replace(motion, name="Zoë 2"))
        assert document["extensionsUsed"] == [vrma.EXTENSION]
        ((name, extension),) = document["extensions"].items()
        assert name == vrma.EXTENSION
        bones = extension["humanoid"]["humanBones"]
        assert extension["specVersion"] == "1.0"
        assert bones.keys() >= REQUIRED
        assert len({bone["node"] for bone in bones.values()}) == len(bones) == num_bones
        assert document["nodes"][0]["name"] == document["animations"][0]["name"] == "Zoë 2"
        assert "meshes" not in document


def test_before_and_after_person_nearest_pose_holds(tmp_path: Path) -> None:
    motion, path = replace(walk(5), start_frame=3), tmp_path / "person.vrma"
    path.write_bytes(b"".join(vrma.encode(motion, np.zeros(3), range(10))))
    found_m = np.concatenate(list(vrma.read_xyz_m(path)))
    np.testing.assert_allclose(found_m, forward_kinematics(motion)[[0, 0, 0, 0, 1, 2, 3, 4, 4, 4]], atol=1e-5)
