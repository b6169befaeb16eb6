"""Files of characters in motion: read back, by three.js and by Khronos' validator; its own bytes are kept."""

import json
import struct
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.core.data.animation import Animation
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.joints import BODY_FEET
from pipeline.export.character.character_files import DESCRIPTION, write_character_files
from pipeline.export.character.gltf_reader import decode_character
from pipeline.export.character.retarget import retarget
from pipeline.export.character.writers import character_bvh, character_fbx, character_glb
from pipeline.export.character.writers.character_fbx import mesh_parts
from pipeline.export.character.writers.posed import PosedCharacter, bone_places, names_by_node
from tests.e2e.foreign import read_with_blender, read_with_three, read_with_ufbx, validate_with_khronos
from tests.pipeline.export.character.characters import bones_of, character, glb
from tests.pipeline.export.character.takes import take_of
from tests.pipeline.export.character.test_retarget import CHARACTERS, figure
from tests.pipeline.motion.skeleton.observed import ring_of

ORIGIN_M = np.array([100.0, -50.0, 0.0])
BEFORE, AFTER = 3, 2


@cache
def posed(name: str) -> PosedCharacter:
    """Character who walks, in a file that begins before and ends after the walk."""
    animation = take_of("walk", "feet", 2.0)
    source = replace(animation.motions[0], start_frame=10)
    frames = range(10 - BEFORE, source.frames.stop + AFTER)
    is_present = np.ones(len(frames), bool)
    is_present[:BEFORE] = is_present[-AFTER:] = False
    return PosedCharacter(retarget(source, figure(name), animation.floor), "Ana", frames, is_present, np.zeros(3))


def written(content: PosedCharacter, path: Path) -> Path:
    writers = {".glb": character_glb, ".bvh": character_bvh, ".fbx": character_fbx}
    path.write_bytes(b"".join(writers[path.suffix].encode(content)))
    return path


def document_of(content: bytes) -> dict[str, Any]:
    (length,) = struct.unpack_from("<I", content, 12)
    return dict(json.loads(content[20 : 20 + length]))


@pytest.mark.parametrize("name", CHARACTERS)
def test_bones_are_where_they_were_put(name: str, tmp_path: Path) -> None:
    content = posed(name)
    for far in (content, replace(content, origin_m=ORIGIN_M)):
        bones = far.bones()
        path = written(far, tmp_path / "a.glb")
        names = tuple(far.motion.figure.rig.names[node] for node in bones)
        places_m = np.concatenate(list(character_glb.read_xyz(path, names)))
        expected_m = bone_places(far, bones, far.frames)
        np.testing.assert_allclose(places_m, expected_m, atol=1e-4)
        path = written(far, tmp_path / "a.fbx")
        places_m = np.concatenate(list(character_fbx.read_xyz(path, names, far.motion.scale)))
        np.testing.assert_allclose(places_m, expected_m, atol=1e-4)
        bones = character_bvh.depth_first(far)
        path = written(far, tmp_path / "a.bvh")
        places_m = np.concatenate(list(character_bvh.read_xyz(path, far.motion.scale, far.origin_m)))
        np.testing.assert_allclose(places_m, bone_places(far, bones, far.frames), atol=1e-4)
    # Before and after the walk the nearest pose holds.
    assert (expected_m[:BEFORE] == expected_m[BEFORE]).all()
    assert (expected_m[-AFTER:] == expected_m[-AFTER - 1]).all()


@pytest.mark.slow
def test_three_reads_bones_within_tenth_of_millimetre(tmp_path: Path) -> None:
    contents = {}
    for name in CHARACTERS:
        for ending in ("glb", "bvh", "fbx"):
            # three.js does not find joints of BVH whose names contain a colon.
            if (name, ending) != ("mixamo", "bvh"):
                contents[written(posed(name), tmp_path / f"{name}.{ending}")] = posed(name)
    for path, issues in validate_with_khronos([path for path in contents if path.suffix == ".glb"]).items():
        # A name of an extension as VRM 0.x has it is all that is found.
        assert issues["numErrors"] == 0, (path, issues["messages"])
        assert issues["numWarnings"] == (path.stem == "vrm 0.x"), (path, issues["messages"])
    for path, read in read_with_three(list(contents)).items():
        content = contents[path]
        bones, names = content.bones(), content.motion.figure.rig.names
        by_node = {node: names[node] for node in bones}
        if path.suffix == ".bvh":
            by_node = names_by_node(by_node)
        units_per_m = content.motion.scale * (1.0 if path.suffix == ".glb" else 100.0)
        expected_m = bone_places(content, bones, content.frames)
        for place, node in enumerate(bones):
            x, y, z = expected_m[:, place].T
            found_m = read.positions[by_node[node]] / units_per_m
            np.testing.assert_allclose(found_m, np.column_stack([x, z, -y]), atol=1e-4, err_msg=path.name)
        assert read.frame_rate_hz == pytest.approx(25.0, rel=1e-4)


@pytest.mark.slow
def test_ufbx_reads_bones_within_tenth_of_millimetre(tmp_path: Path) -> None:
    contents = {}
    for name in ("default", "game_engine", "vrm 1.0", "odd", "ik"):
        # Its reader here takes the times of the first curve for those of all.
        content = replace(posed(name), is_present=np.ones(len(posed(name).frames), bool))
        contents[written(content, tmp_path / f"{name}.fbx")] = content
    for path, read in read_with_ufbx(list(contents)).items():
        content = contents[path]
        expected_m = bone_places(content, content.bones(), content.frames)
        for place, node in enumerate(content.bones()):
            x, y, z = expected_m[:, place].T
            found_m = read.positions[content.motion.figure.rig.names[node]] / content.motion.scale / 100.0
            np.testing.assert_allclose(found_m, np.column_stack([x, z, -y]), atol=1e-4, err_msg=path.name)


@pytest.mark.slow
def test_blender_reads_bones_within_tenth_of_millimetre(tmp_path: Path) -> None:
    files = [
        written(posed(name), tmp_path / f"{name}.{e}") for name in ("default", "odd", "ik") for e in ("glb", "fbx")
    ]
    for path, read in read_with_blender([(path, 25.0, {}) for path in files], tmp_path).items():
        content = posed(path.stem)
        bones, motion = content.bones(), content.motion
        expected_m = bone_places(content, bones, content.frames)
        for place, node in enumerate(bones):
            found_m = read.positions[motion.figure.rig.names[node]] / motion.scale
            np.testing.assert_allclose(found_m, expected_m[:, place], atol=1e-4, err_msg=path.name)


def test_character_s_own_bytes_are_kept(tmp_path: Path) -> None:
    content = posed("mixamo")
    file = content.motion.figure.file
    again = decode_character("a.glb", written(content, tmp_path / "a.glb").read_bytes())
    assert again.binary[: len(file.binary)] == file.binary
    assert again.document["meshes"] == file.document["meshes"]
    assert again.document["skins"] == file.document["skins"]
    before = len(file.document["accessors"])
    assert again.document["accessors"][:before] == file.document["accessors"]
    (animation,) = again.document["animations"]
    assert animation["name"] == "Ana"
    assert animation["extras"] == {
        "start_frame": content.frames.start,
        "frame_rate_hz": 25.0,
        "units_per_m": content.motion.scale,
        "present": [[10, content.frames.stop - AFTER]],
    }
    assert written(content, tmp_path / "b.glb").read_bytes() == (tmp_path / "a.glb").read_bytes()


def test_mesh_of_fbx_is_that_of_glb(tmp_path: Path) -> None:
    """Bodies as three.js draws them have the same area in each frame."""
    content = replace(posed("vrm 1.0"), is_present=np.ones(len(posed("vrm 1.0").frames), bool))
    paths = [written(content, tmp_path / f"a.{ending}") for ending in ("glb", "fbx")]
    of_glb, of_fbx = (read.areas_m2 for read in read_with_three(paths, with_areas=True).values())
    assert of_glb.shape == (len(content.frames), 1)
    assert of_glb.min() > 0.1
    np.testing.assert_allclose(of_fbx / 1e4, of_glb, rtol=1e-4)


def test_meshes_for_other_formats() -> None:
    content = character(bones_of("game_engine"), sole=("foot_l",))
    document = document_of(content)
    start = 20 + struct.unpack_from("<I", content, 12)[0] + 8
    hand = next(number for number, node in enumerate(document["nodes"]) if node["name"] == "hand_r")
    document["materials"] = [{"pbrMetallicRoughness": {"baseColorFactor": [1.0, 0.0, 0.5, 1.0]}}]
    document["meshes"][0]["primitives"][0]["material"] = 0
    # A mesh without a skin hangs on a bone.
    document["meshes"].append({"primitives": [{"attributes": {"POSITION": 1}, "indices": 4}]})
    document["nodes"].append({"name": "sword", "mesh": 1})
    document["nodes"][hand]["children"] = [*document["nodes"][hand].get("children", []), len(document["nodes"]) - 1]
    file = decode_character("a.glb", glb(document, content[start:]))
    body, sword = mesh_parts(file)
    assert body.rgb == (255, 0, 186)
    (skinned,) = file.skinned
    np.testing.assert_allclose(body.positions, skinned.positions, atol=1e-6)
    np.testing.assert_array_equal(body.bones[:, 0], skinned.bones)
    np.testing.assert_allclose(body.weights.sum(1), 1.0)
    np.testing.assert_allclose(np.linalg.norm(body.normals, axis=-1)[body.triangles].min(), 1.0)
    assert (sword.name, set(sword.bones.ravel().tolist())) == ("sword", {hand})
    assert len(sword.triangles) == len(body.triangles)


def test_nodes_with_matrices_move_too(tmp_path: Path) -> None:
    plain = character(bones_of("game_engine"), is_pointing=False)
    document = document_of(plain)
    for node in document["nodes"]:
        if "translation" in node:
            matrix = np.eye(4)
            matrix[:3, 3] = node.pop("translation")
            del node["rotation"]
            node["matrix"] = matrix.T.reshape(-1).tolist()
    start = 20 + struct.unpack_from("<I", plain, 12)[0] + 8
    with_matrices = decode_character("a.glb", glb(document, plain[start:]))
    content = posed("game_engine")
    motion = replace(content.motion, figure=replace(content.motion.figure, file=with_matrices))
    path = written(replace(content, motion=motion), tmp_path / "a.glb")
    assert validate_with_khronos([path])[path]["numErrors"] == 0
    bones = content.bones()
    names = tuple(content.motion.figure.rig.names[node] for node in bones)
    places_m = np.concatenate(list(character_glb.read_xyz(path, names)))
    np.testing.assert_allclose(places_m, bone_places(content, bones, content.frames), atol=1e-4)


def test_files_of_take(tmp_path: Path) -> None:
    animation = take_of("walk", "feet", 2.0)
    take = Reconstruction(ring_of(2), BODY_FEET, Timebase(0.0, 25.0, 60), (), (), animation)
    results = list(write_character_files(take, figure("default"), tmp_path, ("bvh", "trc", "fbx")))
    assert [result.path.name for result in results] == [f"person-1.character.{name}" for name in ("glb", "bvh", "fbx")]
    described = json.loads((tmp_path / DESCRIPTION).read_text(encoding="utf-8"))
    assert described["method"] == "names"
    assert described["bones"]["LeftHand"] == "wrist.L"
    (person,) = described["people"]
    assert person["contacts_kept"] == 1.0
    assert person["slide_cm"] <= 0.1
    assert person["penetration_cm"] <= 0.5
    assert max(person["max_distance_mm"].values()) <= 0.1
    # All frames of the take, half of them at half the rate; without BVH the GLB alone.
    document = document_of((tmp_path / "person-1.character.glb").read_bytes())
    assert document["accessors"][-1]["count"] == 60
    (result,) = write_character_files(take, figure("default"), tmp_path, (), 12.5)
    assert document_of(result.path.read_bytes())["accessors"][-1]["count"] == 30
    (result,) = write_character_files(take, figure("default"), tmp_path, (), timeline="person")
    assert document_of(result.path.read_bytes())["accessors"][-1]["count"] == animation.tracks[0].num_frames


def test_take_without_people_has_description_alone(tmp_path: Path) -> None:
    empty = Reconstruction(ring_of(2), BODY_FEET, Timebase(0.0, 25.0, 5), (), (), Animation((), (), None))
    assert list(write_character_files(empty, figure("default"), tmp_path)) == []
    assert json.loads((tmp_path / DESCRIPTION).read_text(encoding="utf-8"))["people"] == []
