"""Output that can't be written: a sentence that names it, before the work where that takes minutes."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from api.cli.main import app
from pipeline.core.data.animation import Animation
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.errors import PipelineError
from pipeline.core.joints import COCO_17
from pipeline.export.results import write_results

runner = CliRunner()


def test_results_that_cannot_be_written_are_no_stack_trace(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    nobody = Reconstruction((), COCO_17, Timebase(0.0, 25.0, 1), (), (), Animation((), (), None))
    with pytest.raises(PipelineError, match="can't be written"):
        write_results(nobody, tmp_path / "file" / "results")


@pytest.mark.parametrize(
    "command",
    [
        ["demo", "--out"],
        ["simulate", "--scene", "room", "--out"],
        ["benchmark", "tracking", "--plot"],
        ["check", "--calibration", "cameras.toml", "--videos", "videos", "--thumbnails"],
        ["sync", "--calibration", "cameras.toml", "--videos", "videos", "--report"],
        ["calibrate", "board", "--board", "chessboard:9x6:0.03", "--videos", "videos", "--out"],
        ["calibrate", "people", "--stature-m", "1.8", "--videos", "videos", "--out"],
        ["calibrate", "people", "--stature-m", "1.8", "--videos", "videos", "--out", "cameras.toml", "--report"],
    ],
    ids=lambda command: "-".join([*command[:2], command[-1].strip("-")]),
)
def test_output_that_cannot_be_written_is_said(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    result = runner.invoke(app, [*command, str(tmp_path / "file" / "results" / "some.json")])
    assert result.exit_code == 1
    assert result.stderr.lstrip("\n").startswith(f"error {tmp_path}")
    assert "can't be written: Not a directory." in result.stderr.replace("\n", " ")
    assert list(tmp_path.rglob("*")) == [tmp_path / "file"], "nothing is left behind"
