"""Human bodies in GLB and FBX files."""

import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import Floor, SkeletonMotion
from pipeline.core.errors import ModelError
from pipeline.core.options.config import Preset
from pipeline.export.presets import GLTF
from pipeline.export.writers import fbx, glb
from pipeline.export.writers.body_mesh import BodyChoice, body_at_rest
from pipeline.export.writers.fbx import convention_of_fbx
from pipeline.motion.body import installed
from pipeline.motion.body.joints import TWIST_JOINTS
from pipeline.motion.body.shape import shape_body
from pipeline.motion.skeleton.model import INDEX, WHOLE_SKELETON, find_skeleton, forward_kinematics
from tests.e2e.exported import is_a_picture_of_people
from tests.e2e.foreign import (
    Animated,
    read_with_assimp,
    read_with_blender,
    read_with_three,
    read_with_ufbx,
    validate_with_khronos,
)
from tests.pipeline.export.writers.test_bvh import walk
from tests.pipeline.motion.body.conftest import in_pose
from tests.pipeline.motion.skeleton.hands.people import gesturing

HUMAN = BodyChoice("human")
ORIGIN_M = np.zeros(3)


@pytest.fixture(autouse=True)
def _human() -> None:
    installed.install()


MOTIONS = pytest.mark.parametrize("motion", [gesturing(12), walk(12)], ids=["fingers", "no fingers"])


def skinned_m(content: bytes, frame: int) -> np.ndarray:
    """World positions of the body's vertices in a frame of a GLB file, by the file alone."""
    length = int.from_bytes(content[12:16], "little")
    document, binary = json.loads(content[20 : 20 + length]), content[28 + length :]
    kinds = {5126: "<f4", 5121: "u1", 5123: "<u2"}
    columns = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}

    def rows(number: int) -> np.ndarray:
        accessor = document["accessors"][number]
        kind, width = np.dtype(kinds[accessor["componentType"]]), columns[accessor["type"]]
        start = document["bufferViews"][accessor["bufferView"]]["byteOffset"]
        values = np.frombuffer(binary, kind, accessor["count"] * width, start).reshape(-1, width).astype(float)
        return values / np.iinfo(kind).max if accessor.get("normalized") else values

    nodes, animation, skin = document["nodes"], document["animations"][0], document["skins"][0]
    moved = {
        (channel["target"]["node"], channel["target"]["path"]): rows(
            animation["samplers"][channel["sampler"]]["output"]
        )
        for channel in animation["channels"]
    }
    parents = {child: number for number, node in enumerate(nodes) for child in node.get("children", ())}
    world: dict[int, np.ndarray] = {}

    def transform(number: int) -> np.ndarray:
        if number not in world:
            local = np.eye(4)
            turn, place = moved.get((number, "rotation")), moved.get((number, "translation"))
            local[:3, :3] = np.eye(3) if turn is None else Rotation.from_quat(turn[frame]).as_matrix()
            local[:3, 3] = nodes[number].get("translation", (0, 0, 0)) if place is None else place[frame]
            world[number] = transform(parents[number]) @ local if number in parents else local
        return world[number]

    inverse = rows(skin["inverseBindMatrices"]).reshape(-1, 4, 4).swapaxes(1, 2)
    maps = np.array([transform(joint) for joint in skin["joints"]]) @ inverse
    attributes = document["meshes"][0]["primitives"][0]["attributes"]
    vertices_m = np.column_stack(
        [rows(attributes["POSITION"]), np.ones(document["accessors"][attributes["POSITION"]]["count"])]
    )
    blended = np.einsum("vi,vixy->vxy", rows(attributes["WEIGHTS_0"]), maps[rows(attributes["JOINTS_0"]).astype(int)])
    return GLTF.xyz_m_from_file((blended @ vertices_m[..., None])[:, :3, 0])


def area_m2(vertices_m: np.ndarray, triangles: np.ndarray) -> float:
    """Area of a mesh."""
    first, second, third = np.moveaxis(vertices_m[triangles], 1, 0)
    return float(np.linalg.norm(np.cross(second - first, third - first), axis=-1).sum() / 2)


@MOTIONS
def test_glb_file_bends_body_as_skeleton_does(motion: SkeletonMotion) -> None:
    content = b"".join(glb.encode(motion, ORIGIN_M, body=HUMAN))
    body = shape_body(installed.load(), motion.bone_length_m)
    for frame in (0, 11):
        vertices_m, _ = in_pose(body, motion.parent_from_joint[frame], motion.root_m[frame])
        np.testing.assert_allclose(skinned_m(content, frame), vertices_m, atol=2e-5)


@MOTIONS
def test_joints_of_glb_file_are_those_of_skeleton(motion: SkeletonMotion, tmp_path: Path) -> None:
    path = tmp_path / "person.glb"
    path.write_bytes(b"".join(glb.encode(motion, ORIGIN_M, body=HUMAN)))
    read_m = np.concatenate(list(glb.read_xyz_m(path)))
    np.testing.assert_allclose(read_m, forward_kinematics(motion), atol=1e-4)
    assert path.stat().st_size < 800_000


@pytest.mark.parametrize("preset", ["default", "unreal", "blender", "mixamo"])
def test_joints_of_fbx_file_are_those_of_skeleton(preset: Preset, tmp_path: Path) -> None:
    motion, path = gesturing(12), tmp_path / "person.fbx"
    path.write_bytes(b"".join(fbx.encode(motion, preset, ORIGIN_M, body=HUMAN)))
    read_m = np.concatenate(list(fbx.read_xyz_m(path, preset)))
    np.testing.assert_allclose(read_m, forward_kinematics(motion), atol=1e-4)
    convention = convention_of_fbx(preset)
    for twist in TWIST_JOINTS:
        assert convention.name(twist.name).encode() in path.read_bytes()


def test_glb_file_is_valid(tmp_path: Path) -> None:
    path = tmp_path / "person.glb"
    motion, is_present = gesturing(12), np.arange(12) > 3
    path.write_bytes(b"".join(glb.encode(motion, ORIGIN_M, is_present=is_present, body=HUMAN)))
    issues = validate_with_khronos([path])[path]
    assert (issues["numErrors"], issues["numWarnings"]) == (0, 0)


def test_three_js_finds_joints_and_hides_absent_people(tmp_path: Path) -> None:
    motion, is_present = gesturing(12), np.arange(12) > 3
    of_glb, of_fbx = tmp_path / "person.glb", tmp_path / "person.fbx"
    of_glb.write_bytes(b"".join(glb.encode(motion, ORIGIN_M, is_present=is_present, body=HUMAN)))
    of_fbx.write_bytes(b"".join(fbx.encode(motion, "default", ORIGIN_M, body=HUMAN)))
    expected_m = forward_kinematics(motion)
    found = {**read_with_three([of_glb], with_areas=True), **read_with_three([of_fbx])}
    for path, units_per_m in ((of_glb, 1.0), (of_fbx, 100.0)):
        joints = {joint.name: number for number, joint in enumerate(WHOLE_SKELETON)}
        assert found[path].positions.keys() == joints.keys() | {twist.name for twist in TWIST_JOINTS}
        for name, number in joints.items():
            read_m = GLTF.xyz_m_from_file(found[path].positions[name] / units_per_m)
            np.testing.assert_allclose(read_m, expected_m[:, number], atol=1e-4)
    (areas_m2,) = found[of_glb].areas_m2.T
    assert (areas_m2[~is_present] < 0.1).all()
    assert (areas_m2[is_present] > 1.4).all()


@pytest.mark.parametrize("read", [read_with_assimp, pytest.param(read_with_ufbx, marks=pytest.mark.slow)])
@MOTIONS
def test_other_readers_of_fbx_find_joints(
    motion: SkeletonMotion, read: Callable[[Sequence[Path]], dict[Path, Animated]], tmp_path: Path
) -> None:
    path = tmp_path / "person.fbx"
    path.write_bytes(b"".join(fbx.encode(motion, "default", ORIGIN_M, body=HUMAN)))
    expected_m = forward_kinematics(motion)
    names = [joint.name for joint in find_skeleton(expected_m.shape[1])]
    positions = read([path])[path].positions
    assert positions.keys() == {*names, *(twist.name for twist in TWIST_JOINTS)}
    for number, name in enumerate(names):
        np.testing.assert_allclose(GLTF.xyz_m_from_file(positions[name] / 100.0), expected_m[:, number], atol=1e-4)


# At 29.97 Hz, the rate of the other walk, Blender's importer of FBX places keys late (docs/lab/limits.md).
@pytest.mark.blender
@pytest.mark.parametrize("motion", [gesturing(12), walk(12, 30.0)], ids=["fingers", "no fingers"])
def test_blender_finds_joints_and_bends_body(motion: SkeletonMotion, tmp_path: Path) -> None:
    of_glb, of_fbx = tmp_path / "person.glb", tmp_path / "person.fbx"
    of_glb.write_bytes(b"".join(glb.encode(motion, ORIGIN_M, body=HUMAN)))
    of_fbx.write_bytes(b"".join(fbx.encode(motion, "blender", ORIGIN_M, body=HUMAN)))
    pictures = Path(os.environ.get("MULTICAP_PICTURES", tmp_path)).absolute()
    pictures.mkdir(parents=True, exist_ok=True)
    picture = pictures / f"human-of-{len(motion.bone_length_m)}-joints.jpg"
    found = read_with_blender([(path, motion.frame_rate_hz, {}) for path in (of_glb, of_fbx)], tmp_path, picture)
    expected_m = forward_kinematics(motion)
    body = shape_body(installed.load(), motion.bone_length_m)
    for path, name in ((of_glb, GLTF.name), (of_fbx, convention_of_fbx("blender").name)):
        read = found[path]
        assert read.positions.keys() >= {name(twist.name) for twist in TWIST_JOINTS}
        for number, joint in enumerate(find_skeleton(expected_m.shape[1])):
            np.testing.assert_allclose(read.positions[name(joint.name)], expected_m[:, number], atol=1e-4)
        for frame in (0, len(expected_m) - 1):
            vertices_m, _ = in_pose(body, motion.parent_from_joint[frame], motion.root_m[frame])
            assert read.areas_m2[frame].sum() == pytest.approx(area_m2(vertices_m, body.triangles), rel=0.001)
    assert is_a_picture_of_people(picture)


def test_rest_poses_of_presets_are_same_body() -> None:
    """Arms that hang half down have the length and, within what joints bend away, the volume of outstretched arms."""
    motion = gesturing(1)
    outstretched, lowered = (body_at_rest(motion, convention_of_fbx(preset), HUMAN) for preset in ("default", "unreal"))
    hands = outstretched.mesh.joints[:, 0] == INDEX["LeftHandMiddle3"]
    for body in (outstretched, lowered):
        tip = body.positions[INDEX["LeftHandMiddle3End"]]
        assert np.linalg.norm(body.mesh.vertices[hands] - tip, axis=-1).min() < 1.5
    assert lowered.mesh.vertices[hands, 1].mean() < outstretched.mesh.vertices[hands, 1].mean() - 40.0
    np.testing.assert_allclose(np.linalg.norm(lowered.mesh.normals, axis=-1), 1.0)


def test_body_stands_on_floor_of_take() -> None:
    motion = gesturing(30)
    assert not motion.contacts
    plain = body_at_rest(motion, GLTF, HUMAN)
    floored = body_at_rest(motion, GLTF, BodyChoice("human", Floor(0.3, 0.0, 0.0)))
    # Without contacts of the feet, nobody knows how high the ankles are.
    np.testing.assert_array_equal(plain.mesh.vertices, floored.mesh.vertices)
    assert plain.mesh.vertices[:, 1].min() == pytest.approx(0.0, abs=0.002)


def test_person_who_is_not_there_has_hardly_any_area() -> None:
    motion = gesturing(12)
    is_present = np.ones(12, bool)
    is_present[:4] = False
    content = b"".join(glb.encode(motion, ORIGIN_M, is_present=is_present, body=HUMAN))
    length = int.from_bytes(content[12:16], "little")
    document = json.loads(content[20 : 20 + length])
    mesh = body_at_rest(motion, GLTF, HUMAN).mesh
    accessor = document["accessors"][document["meshes"][0]["primitives"][0]["targets"][0]["POSITION"]]
    start = 28 + length + document["bufferViews"][accessor["bufferView"]]["byteOffset"]
    shrunk = mesh.vertices + np.frombuffer(content, "<f4", accessor["count"] * 3, start).reshape(-1, 3)

    assert 1.4 < area_m2(mesh.vertices, mesh.triangles) < 2.6
    assert area_m2(shrunk, mesh.triangles) < 0.1


def test_without_installed_human_error_says_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MULTICAP_HOME", str(tmp_path))
    with pytest.raises(ModelError, match="Run: multicap bodies install"):
        list(glb.encode(gesturing(2), ORIGIN_M, body=HUMAN))


def test_equal_motions_give_equal_bytes() -> None:
    def files() -> tuple[bytes, bytes]:
        of_glb, of_fbx = glb.encode(walk(4), ORIGIN_M, body=HUMAN), fbx.encode(walk(4), "default", ORIGIN_M, body=HUMAN)
        return b"".join(of_glb), b"".join(of_fbx)

    assert files() == files()
