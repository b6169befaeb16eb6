"""Accuracy on the Shelf benchmark; skipped without its folder."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from api.cli.main import app
from tests.e2e.datasets import evaluated, folder_of, needs

FOLDER = folder_of("shelf")
NEEDS_SHELF = needs("shelf")


@NEEDS_SHELF
def test_shelf() -> None:
    scores = evaluated("shelf")
    # The paper has 96.8 from 99.6 / 93.2 / 97.5.
    assert scores["pcp"]["average"] >= 96.9
    assert (np.array(scores["pcp"]["actors"]) >= [99.4, 92.5, 97.5]).all()
    assert scores["switches"] == 0
    assert scores["association_accuracy"] >= 0.97
    # One box of 255 in the last camera is lost since backs are not bent to the rear.
    assert min(scores["mota"].values()) >= 0.976
    assert min(scores["idf1"].values()) >= 0.988
    assert scores["ghost_tracks"] == 0


@NEEDS_SHELF
def test_shelf_by_clustering() -> None:
    command = [
        sys.executable,
        "-m",
        "api.cli.main",
        "evaluate",
        "shelf",
        f"--data={FOLDER}",
        "--method=clustering",
        "--json",
    ]
    scores = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    # The paper has 95.47 from 99.41 / 91.89 / 95.12.
    assert scores["method"] == "clustering"
    assert scores["pcp"]["average"] >= 95.5
    assert (np.array(scores["pcp"]["actors"]) >= [99.0, 91.0, 95.0]).all()
    assert scores["association_accuracy"] is None
    assert 0 < scores["bone_std_cm"] < 4


@NEEDS_SHELF
def test_live_capture_of_real_people_is_near_finished_session() -> None:
    scores = evaluated("shelf", "--live")
    assert scores["live"]["people"] == 4
    assert scores["live"]["switches"] == 0
    assert scores["live"]["pcp"]["average"] >= scores["pcp"]["average"] - 1.0


@NEEDS_SHELF
@pytest.mark.accuracy
def test_shelf_at_one_image_in_five() -> None:
    whole, thinned = (evaluated("shelf", "--smoothing=none", f"--every={every}") for every in (1, 5))
    assert whole["pcp"]["average"] - thinned["pcp"]["average"] <= 3.0


@NEEDS_SHELF
@pytest.mark.accuracy
def test_shelf_at_one_image_in_five_and_what_parts_are_worth() -> None:
    # In a child process without checks of shapes, which would take four times as long as the work.
    command = [sys.executable, "-m", "api.cli.main", "evaluate", "shelf", f"--data={FOLDER}", "--every=5", "--ablation"]
    command.append("--smoothing=none")  # the ablation concerns the steps before smoothing
    result = subprocess.run([*command, "--json"], capture_output=True, text=True, check=True)
    scores = json.loads(result.stdout)
    by_every = {row["every"]: row for row in scores["ablation"]["every"]}
    assert scores["pcp"]["average"] == pytest.approx(by_every[5]["robust"])
    lost = {kind: by_every[1][kind] - by_every[5][kind] for kind in ("robust", "conventional")}
    assert lost["robust"] <= 3.0 < lost["conventional"]
    association = scores["ablation"]["association"]
    assert association["tracking"]["all"] > association["pairs_of_views"]["all"]
    assert len(scores["ablation"]["weights"]) == 6
    single = scores["ablation"]["single_view"]
    assert all(single["idf1"][camera] < 0.9 for camera in single["idf1"])
    assert set(scores["ablation"]["triangulation"]) >= {"conventional", "incremental_without_norm", "incremental"}


def test_all_missing_and_unreadable_files_are_reported(tmp_path: Path) -> None:
    (tmp_path / "gt.npz").write_text("no archive")
    np.savez(tmp_path / "other.npz", cam=np.zeros(1), frame=np.zeros(1))
    result = CliRunner().invoke(
        app, ["evaluate", "shelf", f"--data={tmp_path}", f"--detections={tmp_path / 'other.npz'}", "--json"]
    )
    assert result.exit_code == 2
    files = {problem["file"] for problem in json.loads(result.stdout)["problems"]}
    assert files == {"gt.npz", "other.npz", "calibration_shelf.json"}
