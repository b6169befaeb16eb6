"""Accuracy on the Shelf benchmark, where that folder is at hand."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from api.cli import app

FOLDER = Path(os.environ.get("MULTICAP_SHELF", Path(__file__).parents[3] / "shared" / "data" / "shelf"))


@pytest.mark.skipif(not FOLDER.is_dir(), reason="no Shelf benchmark at hand (MULTICAP_SHELF names its folder)")
def test_shelf() -> None:
    result = CliRunner().invoke(app, ["evaluate", "shelf", f"--data={FOLDER}", "--json"])
    assert result.exit_code == 0, result.output
    scores = json.loads(result.stdout)
    # The paper has 96.8 from 99.6 / 93.2 / 97.5.
    assert scores["pcp"]["average"] >= 96.9
    assert (np.array(scores["pcp"]["actors"]) >= [99.4, 92.5, 97.5]).all()
    assert scores["switches"] == 0
    assert scores["association_accuracy"] >= 0.97
    assert min(scores["mota"].values()) >= 0.98
    assert min(scores["idf1"].values()) >= 0.99


def test_all_that_is_missing_is_said(tmp_path: Path) -> None:
    (tmp_path / "gt.npz").write_text("no archive")
    np.savez(tmp_path / "other.npz", cam=np.zeros(1), frame=np.zeros(1))
    result = CliRunner().invoke(
        app, ["evaluate", "shelf", f"--data={tmp_path}", f"--detections={tmp_path / 'other.npz'}", "--json"]
    )
    assert result.exit_code == 2
    files = {problem["file"] for problem in json.loads(result.stdout)["problems"]}
    assert files == {"gt.npz", "other.npz", "calibration.json"}
