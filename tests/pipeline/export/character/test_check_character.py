"""Check of a character's file in a process of its own: facts, bones, and damaged files."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from api.web.sessions.preflight import CharacterContents
from pipeline.export.character import check_character
from pipeline.export.character.gltf_reader import decode_character
from tests.pipeline.export.character.characters import bones_of, character, glb, parts, vrm
from tests.pipeline.export.character.fbx.fbx_characters import fbx_of, mutated_fbx
from tests.pipeline.export.character.test_gltf_reader import changed

MIXAMO = character(bones_of("mixamo"), unit=100.0, armature_scale=0.01)


def checked(path: Path, capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, dict[str, Any]]:
    code = check_character.main([str(path), *words])
    return code, json.loads(capsys.readouterr().out)


def test_printed_table_is_readable_by_service(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "robot.vrm"
    path.write_bytes(vrm("1.0"))
    code, printed = checked(path, capsys)
    contents = CharacterContents.model_validate(printed)
    assert (code, contents.format, contents.method) == (0, "VRM 1.0", "vrm")
    assert contents.stature == pytest.approx(1.66, abs=0.01)
    names = [bone.bone for bone in contents.skeleton]
    assert len(names) == contents.num_bones
    assert all(bone.parent is None or names.index(bone.parent) < place for place, bone in enumerate(contents.skeleton))


def test_names_that_fill_answers_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "robot.glb"
    path.write_bytes(MIXAMO)
    monkeypatch.setattr(check_character, "MAX_CONTENTS_BYTES", 1000)
    code, printed = checked(path, capsys)
    assert (code, [problem["code"] for problem in printed["problems"]]) == (2, ["character_too_large"])


def test_scales_that_overflow_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    document, binary = parts(MIXAMO)
    nodes = document["nodes"]
    start = len(nodes)
    nodes += [{"scale": [1e6] * 3, "children": [number + 1]} for number in range(start, start + 60)]
    nodes.append({"children": [0]})
    document["scenes"] = [{"nodes": [start]}]
    path = tmp_path / "robot.glb"
    path.write_bytes(glb(document, binary))
    with np.errstate(all="ignore"):
        code, printed = checked(path, capsys)
    assert (code, [problem["code"] for problem in printed["problems"]]) == (2, ["character_unreadable"])


@pytest.mark.parametrize("num_files", [50, pytest.param(200, marks=pytest.mark.slow)])
def test_mutated_files_are_answered(num_files: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of mutated files each is described or refused; nothing is raised, and nothing but JSON is printed."""
    rng = np.random.default_rng(39)
    document, binary = parts(MIXAMO)
    codes = []
    for number in range(num_files):
        path = tmp_path / "robot.glb"
        path.write_bytes(mutated(number, document, binary, rng))
        with np.errstate(all="ignore"):
            code, printed = checked(path, capsys)
        codes.append(code)
        if code == 0:
            CharacterContents.model_validate(printed)
        else:
            assert printed["problems"]
    assert set(codes) == {0, 2}
    assert codes.count(2) > num_files // 4


@pytest.mark.parametrize("num_files", [40, pytest.param(200, marks=pytest.mark.slow)])
def test_mutated_fbx_files_are_answered(num_files: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng, path, codes = np.random.default_rng(39), tmp_path / "robot.fbx", []
    content = fbx_of(decode_character("a.glb", MIXAMO))
    for number in range(num_files):
        path.write_bytes(mutated_fbx(content, number, rng))
        with np.errstate(all="ignore"):
            code, printed = checked(path, capsys)
        codes.append(code)
        if code == 0:
            assert CharacterContents.model_validate(printed).format == "FBX"
        else:
            assert {problem["code"].split("_")[0] for problem in printed["problems"]} == {"character"}
    assert set(codes) == {0, 2}
    assert codes.count(0) > num_files // 6
    assert codes.count(2) > num_files // 4


def mutated(number: int, document: dict[str, Any], binary: bytes, rng: np.random.Generator) -> bytes:
    """A file with damaged bytes, or with a few other values in its description."""
    if number % 2:
        return glb(changed(document, rng), binary)
    content = bytearray(MIXAMO)
    head = 20 + struct.unpack_from("<I", content, 12)[0]
    for _ in range(1 + number % 7):
        content[int(rng.integers(0, head if rng.random() < 0.5 else len(content)))] = int(rng.integers(0, 256))
    return bytes(content)
