"""``multicap reconstruct --character``: files of a take on a character, and what is wrong with one before any work."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from api.cli.main import app
from pipeline.validation.simulation.scenes import record
from tests.pipeline.capture.synchronization.conftest import shortened
from tests.pipeline.export.character.characters import bones_of, character
from tests.pipeline.simulations import write_simulation

runner = CliRunner()


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of two seconds of a simulated walk, and of a character."""
    folder = tmp_path_factory.mktemp("take")
    write_simulation(record(shortened("walk", 2.0), 1, 4), folder)
    (folder / "robot.glb").write_bytes(character(bones_of("mixamo"), unit=100.0, armature_scale=0.01))
    return folder


def command(take: Path, out: Path, *options: str) -> list[str]:
    paths = ("--keypoints", str(take / "keypoints"), "--calibration", str(take / "calibration.json"))
    times = ("--timestamps", str(take / "timestamps.csv"))
    return ["reconstruct", *paths, *times, "--no-cache", "--json", "--out", str(out), *options]


def test_everybody_moves_character(take: Path, tmp_path: Path) -> None:
    table = tmp_path / "bones.json"
    table.write_text(json.dumps({"bones": {"LeftToeBase": None}}))
    options = ("--character", str(take / "robot.glb"), "--bones", str(table))
    result = runner.invoke(app, command(take, tmp_path / "out", *options))
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    names = {Path(path).name for path in document["files"]}
    people = [track["id"] for track in document["tracks"]]
    assert people
    assert {f"person-{number}.character.{ending}" for number in people for ending in ("glb", "bvh")} <= names
    assert all(Path(path).is_file() for path in document["files"])
    described = json.loads((tmp_path / "out" / "character.json").read_text(encoding="utf-8"))
    assert described["missing"] == ["LeftToeBase"]
    assert [person["id"] for person in described["people"]] == people
    assert all(person["contacts_kept"] >= 0.98 and person["slide_cm"] <= 0.1 for person in described["people"])


def test_character_problems_are_told_before_work(take: Path, tmp_path: Path) -> None:
    fbx = tmp_path / "robot.fbx"
    fbx.write_bytes(b"; FBX 7.4.0 project file")
    table = tmp_path / "bones.json"
    table.write_text(json.dumps({"bones": {"LeftArm": "Nobody"}}))
    for options, code in (
        (("--character", str(fbx)), "character_format"),
        (("--character", str(take / "robot.glb"), "--bones", str(table)), "bones_invalid"),
        (("--bones", str(table)), "bones_invalid"),
    ):
        result = runner.invoke(app, command(take, tmp_path / "out", *options))
        assert result.exit_code == 2, result.output
        (problem,) = json.loads(result.stdout)["problems"]
        assert problem["code"] == code
        assert problem["hint"]
        assert not (tmp_path / "out").exists()
