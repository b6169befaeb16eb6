"""Characters out of GLB and VRM files; damaged and foreign files are refused with clear errors."""

import json
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.core.errors import InputError
from pipeline.export.character.figure import measure
from pipeline.export.character.gltf_reader import decode_character
from pipeline.export.character.mapping import map_bones
from pipeline.export.character.rig import MAX_NODES
from pipeline.export.character.source import read_character_file
from tests.pipeline.export.character.characters import bones_of, character, glb, parts, vrm

MIXAMO = character(bones_of("mixamo"), unit=100.0, armature_scale=0.01)


def code_of(content: bytes) -> str:
    with pytest.raises(InputError) as raised:
        decode_character("a.glb", content)
    (problem,) = raised.value.problems
    assert problem.file == "a.glb"
    assert problem.hint
    return problem.code


def test_bones_stand_where_they_were_put() -> None:
    bones = bones_of("mixamo")
    rig = decode_character("a.glb", MIXAMO).rig
    for name, (parent, head, _) in bones.items():
        number = rig.names.index(name)
        x, y, z = head * 100.0
        np.testing.assert_allclose(rig.positions[number], (x, z, -y), atol=1e-3)
        assert rig.names[rig.parents[number]] == (parent or "Armature")
    assert rig.is_bone.sum() == len(bones)


def test_mesh_is_read_in_rest_pose() -> None:
    read = decode_character("a.glb", MIXAMO)
    (skinned,) = read.skinned
    # Six vertices a bone; the first one at its head, the last one at its tail.
    np.testing.assert_allclose(skinned.positions[::6], read.rig.positions[skinned.bones[::6]], atol=1e-3)


def test_file_saved_in_pose_is_read_at_rest() -> None:
    document, binary = parts(MIXAMO)
    posed = next(node for node in document["nodes"] if node["name"] == "mixamorig:LeftArm")
    posed["rotation"] = [0.0, 0.6, 0.0, 0.8]
    still = decode_character("a.glb", MIXAMO).rig
    rig = decode_character("a.glb", glb(document, binary)).rig
    np.testing.assert_allclose(rig.positions, still.positions, atol=1e-3)


def test_humanoid_table_is_read_in_both_versions() -> None:
    for version in ("0.x", "1.0"):
        read = decode_character("a.vrm", vrm(version))
        assert read.rig.names[read.humanoid["leftLowerLeg"]].startswith("b")
        assert len(read.humanoid) > 20


def test_compressed_files_are_named() -> None:
    document, binary = parts(MIXAMO)
    document["extensionsRequired"] = ["EXT_meshopt_compression"]
    document["buffers"].append({"byteLength": 12})
    with pytest.raises(InputError, match="compressed"):
        decode_character("a.glb", glb(document, binary))


def test_files_of_other_formats_are_refused(tmp_path: Path) -> None:
    assert code_of(b"Kaydara FBX Binary  \x00\x1a\x00") == "character_format"
    assert code_of(b"solid cube") == "character_format"
    assert code_of(b"") == "character_format"
    with pytest.raises(InputError, match="can't be read"):
        read_character_file(tmp_path / "nothing.glb")


def nested(document: dict[str, Any]) -> None:
    document["nodes"] = [{"children": [number + 1]} for number in range(600)] + [{}]
    document["skins"] = []


def circle(document: dict[str, Any]) -> None:
    document["nodes"][5]["children"] = [0]
    document["nodes"][0]["children"] = [5]


def crowd(document: dict[str, Any]) -> None:
    document["nodes"] += [{}] * MAX_NODES


def elsewhere(document: dict[str, Any]) -> None:
    document["buffers"][0]["uri"] = "other.bin"


def outside(document: dict[str, Any]) -> None:
    document["accessors"][1]["count"] = 10**9


def infinite(document: dict[str, Any]) -> None:
    document["nodes"][3]["translation"] = [1e400, 0, 0]


def no_rotation(document: dict[str, Any]) -> None:
    document["nodes"][3]["rotation"] = [0, 0, 0, 0]


@pytest.mark.parametrize(
    ("damage", "code"),
    [
        (nested, "character_unreadable"),
        (circle, "character_unreadable"),
        (crowd, "character_too_large"),
        (elsewhere, "character_unreadable"),
        (outside, "character_unreadable"),
        (infinite, "character_unreadable"),
        (no_rotation, "character_unreadable"),
    ],
)
def test_impossible_input_is_refused(damage: Callable[[dict[str, Any]], None], code: str) -> None:
    document, binary = parts(MIXAMO)
    damage(document)
    assert code_of(glb(document, binary)) == code


@pytest.mark.parametrize("num_files", [50, pytest.param(200, marks=pytest.mark.slow)])
def test_mutated_files_are_read_or_refused(num_files: int) -> None:
    """Of mutated files none raises anything else, or takes more memory than a small multiple of its size."""
    rng = np.random.default_rng(7)
    sources = (MIXAMO, vrm("1.0"))
    document, binary = parts(MIXAMO)
    refused = 0
    for number in range(num_files):
        if number % 2:
            content = bytearray(sources[number // 2 % 2])
            head = 20 + struct.unpack_from("<I", content, 12)[0]
            # Half of the changes hit the description.
            for _ in range(1 + number % 7):
                content[int(rng.integers(0, head if rng.random() < 0.5 else len(content)))] = int(rng.integers(0, 256))
            mutated = bytes(content[: int(rng.integers(1, len(content)))] if number % 10 == 1 else content)
        else:
            mutated = glb(changed(document, rng), binary)
        tracemalloc.start()
        try:
            read = decode_character("mutated.glb", mutated)
            measure(read, map_bones(read))
        except InputError:
            refused += 1
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 64 * len(mutated)
    assert refused > num_files // 4


def changed(document: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """Copy of a document in which a few values are something else."""
    copy = json.loads(json.dumps(document))
    for _ in range(3):
        owner: Any = copy
        while True:
            keys = list(owner) if isinstance(owner, dict) else list(range(len(owner)))
            key = keys[int(rng.integers(len(keys)))]
            inner = owner[key]
            if isinstance(inner, (dict, list)) and inner and rng.random() < 0.9:
                owner = inner
                continue
            others: list[Any] = [None, -1, 0, 1e308, 2**63, "x", [], {}, True, [1, 2], {"a": 1}, -0.5, [[[]]]]
            owner[key] = others[int(rng.integers(len(others)))]
            break
    return dict(copy)
