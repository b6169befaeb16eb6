"""Commands ``multicap calibration show`` and ``convert``."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from api.cli.main import app
from pipeline.calibration.registry import read_contents
from pipeline.calibration.write import encode, encode_opencv
from tests.pipeline.calibration.readers.rigs import RIG, assert_rig

runner = CliRunner()


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    path = tmp_path / "rig.yml"
    path.write_bytes(encode_opencv(RIG))
    return path


def test_show(rig: Path) -> None:
    result = runner.invoke(app, ["calibration", "show", str(rig)])
    assert result.exit_code == 0
    assert "OpenCV; lengths in the file: m, as stated by --units" in result.stderr
    assert [line.split()[0] for line in result.stdout.splitlines()] == ["camera", "left", "right"]
    assert "1920 x 1080" in result.stdout


def test_show_as_json(rig: Path) -> None:
    found = json.loads(runner.invoke(app, ["calibration", "show", str(rig), "--units=mm", "--json"]).stdout)
    assert (found["format"], found["units"]) == ("OpenCV", "mm")
    left = found["cameras"][0]
    assert (left["name"], left["size_px"]) == ("left", [1920, 1080])
    np.testing.assert_allclose(left["translation_m"], RIG[0].cam_from_world.translation_m / 1000)


@pytest.mark.parametrize("ending", [".json", ".toml", ".yml", ".YAML"])
def test_convert(rig: Path, ending: str) -> None:
    target = rig.with_name(f"converted{ending}")
    result = runner.invoke(app, ["calibration", "convert", str(rig), str(target)])
    assert result.exit_code == 0
    assert_rig(read_contents(target), num_digits=9)


def test_what_cannot_be_converted(tmp_path: Path, rig: Path) -> None:
    def problems(*words: str) -> list[str]:
        result = runner.invoke(app, ["calibration", *words, "--json"])
        assert result.exit_code in {1, 2}
        return [problem["code"] for problem in json.loads(result.stdout)["problems"]]

    assert problems("show", str(tmp_path / "none.json")) == ["calibration_missing"]
    assert problems("show", str(rig), "--units=feet") == ["calibration_units"]
    assert problems("convert", str(rig), str(tmp_path / "rig.doc")) == ["calibration_format"]
    assert problems("convert", str(rig), str(tmp_path / "nowhere" / "rig.json")) == ["pipeline_error"]
    unsized = tmp_path / "unsized.yml"
    unsized.write_text("\n".join(line for line in rig.read_text().splitlines() if "image_" not in line))
    assert problems("convert", str(unsized), str(tmp_path / "rig.json")) == ["invalid_size", "invalid_size"]
    assert not (tmp_path / "rig.json").exists()
    own = tmp_path / "own.json"
    own.write_bytes(encode(RIG))
    assert problems("show", str(own), "--units=mm") == ["calibration_units"]
