"""``multicap reconstruct --c3d``: a laboratory's file is merged into people's, and wrong options are named."""

import json
from pathlib import Path

import ezc3d
import numpy as np
import pytest
from typer.testing import CliRunner

from api.cli.main import app
from pipeline.validation.simulation.scenes import record
from tests.pipeline.capture.laboratory.test_laboratory_files import trigger, with_channel
from tests.pipeline.capture.synchronization.conftest import shortened
from tests.pipeline.motion.laboratory.simulated_plates import c3d_bytes
from tests.pipeline.simulations import write_simulation

runner = CliRunner()


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("take")
    write_simulation(record(shortened("walk", 2.0), 1, 4), folder)
    (folder / "trial.c3d").write_bytes(c3d_bytes(with_channel("Sync", trigger())))
    return folder


def reconstruct(take: Path, out: Path, *options: str) -> tuple[int, str]:
    sources = ("--keypoints", str(take / "keypoints"), "--calibration", str(take / "calibration.json"))
    given = ("--timestamps", str(take / "timestamps.csv"), "--no-cache", "--json", "--c3d", str(take / "trial.c3d"))
    result = runner.invoke(app, ["reconstruct", *sources, *given, *options, "--out", str(out)])
    return result.exit_code, result.stdout + result.stderr


def test_file_of_each_person_has_the_laboratory_s_samples(take: Path, tmp_path: Path) -> None:
    code, output = reconstruct(take, tmp_path, "--exports", "c3d", "--c3d-place", "0.5,0,0,90")
    assert code == 0, output
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    found = metrics["laboratory"]
    assert (found["file"], found["clock"], found["num_frames"]) == ("trial.c3d", "trigger", 100)
    assert found["world_from_laboratory"][0] == [0.0, -1.0, 0.0, 0.5]
    assert metrics["exports"]["c3d"]["max_distance_mm"] < 0.01
    before = ezc3d.c3d(str(take / "trial.c3d"))
    for person in (1, 2):
        after = ezc3d.c3d(str(tmp_path / f"person-{person}.c3d"))
        np.testing.assert_array_equal(after["data"]["analogs"], before["data"]["analogs"])
        assert after["data"]["points"].shape[2] == 100
    assert "laboratory_read" in {finding["code"] for finding in json.loads(output.splitlines()[0])["warnings"]}


def test_wrong_options_are_named_at_once(take: Path, tmp_path: Path) -> None:
    code, output = reconstruct(take, tmp_path, "--c3d-clock", "sundial", "--c3d-place", "1,2,east")
    assert code == 2
    assert "There is no clock 'sundial'" in output
    assert "'1,2,east' is not X,Y,Z,DEGREES" in output
    code, output = reconstruct(take, tmp_path, "--c3d-clock", "trigger:EMG 1")
    assert code == 2
    assert "No channel is a trigger with two levels" in output
