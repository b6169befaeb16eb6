"""`multicap check`: findings of keypoint sessions, their exit codes, and problems as findings."""

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from api.cli.main import app
from pipeline.simulation.scenes import find_scene, record
from tests.pipeline.simulations import write_simulation

SIMULATION = record(replace(find_scene("room"), duration_s=4.0), seed=3)


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("session")
    write_simulation(SIMULATION, folder)
    return folder


def checked(folder: Path, calibration: Path, **options: str) -> tuple[int, list[Mapping[str, Any]]]:
    words = ["check", "--keypoints", str(folder / "keypoints"), "--timestamps", str(folder / "timestamps.csv")]
    words += ["--calibration", str(calibration), "--json", *(f"--{name}={value}" for name, value in options.items())]
    answer = CliRunner().invoke(app, words)
    return answer.exit_code, json.loads(answer.stdout)["findings"]


def written(session: Path, folder: Path, change: Callable[[list[Any]], object]) -> Path:
    document = json.loads((session / "calibration.json").read_text())
    change(document["cameras"])
    path = folder / "changed.json"
    path.write_text(json.dumps(document))
    return path


def test_nothing_is_wrong_with_a_good_session(session: Path) -> None:
    assert checked(session, session / "calibration.json") == (0, [])


def test_exchanged_calibrations_are_named(session: Path, tmp_path: Path) -> None:
    def exchange(cameras: list[Any]) -> None:
        cameras[0]["name"], cameras[1]["name"] = cameras[1]["name"], cameras[0]["name"]

    code, findings = checked(session, written(session, tmp_path, exchange))
    names = [camera.name for camera in SIMULATION.cameras[:2]]
    assert code == 2
    assert [one["code"] for one in findings] == ["cameras_exchanged"] * 2
    assert {one["camera"]: one["evidence"]["other_camera"] for one in findings} == {
        names[0]: names[1],
        names[1]: names[0],
    }


def test_problems_are_findings(session: Path, tmp_path: Path) -> None:
    code, findings = checked(session, tmp_path / "missing.json")
    assert code == 2
    assert [(one["code"], one["severity"]) for one in findings] == [("calibration_missing", "error")]
    assert findings[0]["evidence"]["file"] == "missing.json"
