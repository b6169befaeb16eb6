"""Command ``multicap sync`` on keypoints."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from api.cli.main import app
from pipeline.validation.simulation.motion.script import Gesture
from pipeline.validation.simulation.scenes import Scene, record
from tests.pipeline.capture.synchronization.conftest import alone, shortened
from tests.pipeline.simulations import write_simulation

runner = CliRunner()


def arguments(scene: Scene, folder: Path, late: int) -> list[str]:
    """Files of a scene whose second camera started late, by frames; and the options that name them."""
    write_simulation(record(scene, 4, 3), folder)
    second = sorted((folder / "keypoints").iterdir())[1]
    for number, path in enumerate(sorted(second.iterdir())):
        if number < late:
            path.unlink()
        else:
            path.rename(second / f"frame_{number - late:012d}_keypoints.json")
    calibration = str(folder / "calibration.json")
    return ["sync", "--keypoints", str(folder / "keypoints"), "--frame-rate", "25", "--calibration", calibration]


def test_offsets_and_plots(tmp_path: Path) -> None:
    report = tmp_path / "report"
    given = arguments(shortened("room", 6.0), tmp_path / "take", 12)
    result = runner.invoke(app, [*given, "--json", "--report", str(report)])
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    first, second, third = document["offsets_s"]
    assert document["offsets_s"][second] - document["offsets_s"][first] == pytest.approx(0.48, abs=0.01)
    assert document["offsets_s"][third] - document["offsets_s"][first] == pytest.approx(0.0, abs=0.01)
    assert document["certain"] is True
    assert set(document["rates"].values()) == {1.0}
    assert json.loads((report / "sync.json").read_bytes()) == document
    assert {path.name for path in report.glob("*.svg")} == {f"sync_{name}.svg" for name in document["offsets_s"]}


def test_uncertain_answer_is_exit_code_1_with_reasons(tmp_path: Path) -> None:
    result = runner.invoke(app, [*arguments(alone(Gesture.IDLE, 4.0), tmp_path, 12), "--json"])
    assert result.exit_code == 1
    document = json.loads(result.stdout)
    assert document["certain"] is False
    assert {one["code"] for one in document["refusals"]} == {"sync_no_motion"}


def test_sources_are_checked(tmp_path: Path) -> None:
    result = runner.invoke(app, ["sync", "--calibration", str(tmp_path / "none.json"), "--json"])
    assert result.exit_code == 2
    assert [one["code"] for one in json.loads(result.stdout)["problems"]] == ["sources"]
