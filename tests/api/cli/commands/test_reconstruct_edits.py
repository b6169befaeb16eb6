"""``multicap reconstruct --edits``: people are put right, and what does not apply is a warning."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from api.cli.main import app
from pipeline.validation.simulation.scenes import record
from tests.pipeline.capture.synchronization.conftest import shortened
from tests.pipeline.simulations import write_simulation

runner = CliRunner()


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("take")
    write_simulation(record(shortened("walk", 2.0), 1, 4), folder)
    return folder


def reconstruct(take: Path, out: Path, edits: str) -> tuple[int, str]:
    path = out.with_suffix(".json")
    path.write_text(edits)
    sources = ("--keypoints", str(take / "keypoints"), "--calibration", str(take / "calibration.json"))
    options = ("--timestamps", str(take / "timestamps.csv"), "--no-cache", "--json", "--edits", str(path))
    result = runner.invoke(app, ["reconstruct", *sources, *options, "--out", str(out)])
    return result.exit_code, result.stdout + result.stderr


def test_edits_of_file_are_applied(take: Path, tmp_path: Path) -> None:
    edits = [
        {"action": "rename", "person": 1, "name": "Anna"},
        {"action": "remove", "person": {"frame": 3, "place_m": [90.0, 0.0, 1.0]}},
    ]
    code, output = reconstruct(take, tmp_path / "out", json.dumps({"revision": 2, "edits": edits, "run": None}))
    assert code == 0, output
    document = json.loads(output.splitlines()[0])
    (warning,) = (finding for finding in document["metrics"]["capture_checks"] if finding["code"] == "edit_not_applied")
    assert warning["message"].startswith("Edit 2 is not applied. No person of this run is within 0.5 m")
    tracks = json.loads((tmp_path / "out" / "skeletons.json").read_bytes())["tracks"]
    assert tracks[0]["name"] == "Anna"


@pytest.mark.parametrize(
    "edits", ["{", "{}", '[{"action": "rename", "person": 1}]', '[{"action": "remove", "person": 1.5}]']
)
def test_malformed_edits_are_told_before_work(take: Path, tmp_path: Path, edits: str) -> None:
    code, output = reconstruct(take, tmp_path / "out", edits)
    assert code == 2, output
    assert "edits_unreadable" in output
    assert not (tmp_path / "out").exists()
