"""`multicap batch`: takes of a folder and of a list, failures, and runs that are ended and go on."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from api.cli.main import app
from api.cli.takes import find_takes
from pipeline.validation.simulation.scenes import find_scene, record
from tests.pipeline.simulations import write_simulation
from tests.waiting import wait_for


def write_takes(folder: Path, numbers: Sequence[int]) -> Path:
    """Takes of one rig, each of another duration; the calibration is beside their folder."""
    for number in numbers:
        simulation = record(replace(find_scene("walk"), duration_s=0.8 + 0.08 * number), seed=0)
        write_simulation(simulation, folder / f"take{number}")
        (folder / f"take{number}" / "calibration.json").replace(folder.parent / "rig.json")
    return folder


@pytest.fixture
def takes(tmp_path: Path) -> Path:
    return write_takes(tmp_path / "takes", (10, 2))


def run(source: Path, out: Path, *words: str) -> tuple[int, Any]:
    line = ["batch", str(source), "--out", str(out), "--exports", "csv", "--json", *words]
    answer = CliRunner().invoke(app, line)
    return answer.exit_code, json.loads(answer.stdout)


def contents(out: Path) -> dict[str, bytes]:
    return {str(path.relative_to(out)): path.read_bytes() for path in out.rglob("*") if path.is_file()}


def written_at(out: Path) -> dict[str, int]:
    return {str(path): path.stat().st_mtime_ns for path in out.rglob("metrics.json")}


def test_takes_of_folder_in_natural_order_with_table(takes: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    code, answer = run(takes, out, "--calibration", str(tmp_path / "rig.json"))
    assert code == 0, answer
    assert [(row["take"], row["state"]) for row in answer["takes"]] == [("take2", "done"), ("take10", "done")]
    assert all(row["people"] >= 1 and row["reprojection_error_px"] < 5.0 for row in answer["takes"]), answer
    with (out / "batch.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["take"], row["frames"]) for row in rows] == [
        (row["take"], str(row["frames"])) for row in answer["takes"]
    ]
    assert (out / "take2" / "person-1.csv").is_file()


@pytest.mark.slow
def test_results_are_kept_until_choice_or_file_changes(takes: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    code, answer = run(takes, out, "--calibration", str(tmp_path / "rig.json"))
    assert code == 0, answer
    before = written_at(out)
    assert run(takes, out, "--calibration", str(tmp_path / "rig.json"))[1] == answer
    assert written_at(out) == before
    (out / "take2" / "person-1.csv").unlink()
    assert run(takes, out, "--calibration", str(tmp_path / "rig.json"))[0] == 0
    assert (out / "take2" / "person-1.csv").is_file()
    assert {path: at for path, at in written_at(out).items() if "take10" in path}.items() <= before.items()
    assert run(takes, out, "--calibration", str(tmp_path / "rig.json"), "--smoothing", "none")[0] == 0
    assert not written_at(out).items() & before.items()


def test_batch_failure_does_not_stop_rest(takes: Path, tmp_path: Path) -> None:
    (takes / "take2" / "timestamps.csv").write_text("camera,frame\n")
    (takes / "take3").mkdir()
    (takes / "__MACOSX").mkdir()
    code, answer = run(takes, tmp_path / "out", "--calibration", str(tmp_path / "rig.json"))
    assert code == 1
    by_name = {row["take"]: row for row in answer["takes"]}
    assert {name: row["state"] for name, row in by_name.items()} == {
        "take2": "failed",
        "take3": "failed",
        "take10": "done",
    }
    assert "timestamps.csv" in by_name["take2"]["message"]
    assert "neither videos nor keypoints" in by_name["take3"]["message"]
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"batch.csv", "take10"}


def test_path_with_equals_sign_is_no_camera(takes: Path, tmp_path: Path) -> None:
    folder = takes.rename(tmp_path / "day=1")
    (folder / "take2" / "GX010001.mp4").write_bytes(b"")
    (folder / "take2" / "keypoints").rename(tmp_path / "away")
    (video,) = [take for take in find_takes(folder, tmp_path, None, None) if take.videos]
    before = video.fingerprint()
    (folder / "take2" / "GX010001.mp4").write_bytes(b"more")
    assert video.fingerprint() != before


def test_takes_of_list(takes: Path, tmp_path: Path) -> None:
    entries = [
        {"name": "a b", "keypoints": "takes/take2/keypoints", "frame_rate_hz": 25.0, "calibration": "rig.json"},
        {"name": "none", "keypoints": "takes/take10/keypoints", "frame_rate_hz": 25.0},
    ]
    path = tmp_path / "takes.json"
    path.write_text(json.dumps({"takes": entries}))
    code, answer = run(path, tmp_path / "out")
    assert (code, [row["state"] for row in answer["takes"]]) == (1, ["done", "failed"])
    assert "no calibration" in answer["takes"][1]["message"]
    assert (tmp_path / "out" / "a b" / "metrics.json").is_file()


@pytest.mark.parametrize(
    ("document", "words"),
    [
        ({"takes": []}, ["at least 1 item"]),
        ({"takes": [{"name": "../up", "videos": "a"}, {"name": "b"}]}, ["pattern", "either videos or keypoints"]),
        ({"takes": [{"name": "..", "videos": "a"}]}, ["can't be a folder's"]),
        ({"takes": [{"name": "A", "videos": "a"}, {"name": "a", "videos": "b"}]}, ["same name: a"]),
        ([], ["object"]),
    ],
)
def test_wrong_lists_name_everything(document: Any, words: Sequence[str], tmp_path: Path) -> None:
    path = tmp_path / "takes.json"
    path.write_text(json.dumps(document))
    code, answer = run(path, tmp_path / "out")
    assert code == 2
    message = " ".join(problem["message"] for problem in answer["problems"])
    assert all(word in message for word in words), message


@pytest.mark.parametrize("name", ["missing", "empty"])
def test_folders_without_takes_are_refused(name: str, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    code, answer = run(tmp_path / name, tmp_path / "out")
    assert (code, [problem["code"] for problem in answer["problems"]]) == (2, ["takes_unreadable"])


@pytest.mark.slow
def test_run_killed_continues_to_same_bytes(tmp_path: Path) -> None:
    takes = write_takes(tmp_path / "takes", range(8))
    rig, whole, cut = tmp_path / "rig.json", tmp_path / "whole", tmp_path / "cut"
    assert run(takes, whole, "--calibration", str(rig))[0] == 0
    line = [sys.executable, "-m", "api.cli.main", "batch", str(takes), "--out", str(cut), "--calibration", str(rig)]
    for num_done in (2, 5):
        cache = tmp_path / f"cache-{num_done}"
        with subprocess.Popen(
            [*line, "--exports", "csv"], env=os.environ | {"MULTICAP_CACHE_HOME": str(cache)}
        ) as process:
            wait_for(lambda num=num_done: len(list(cut.glob("*/.batch.json"))) >= num or process.poll() is not None)  # type: ignore[misc]
            process.send_signal(signal.SIGKILL)
        shutil.rmtree(cache, ignore_errors=True)
    assert 2 <= len(list(cut.glob("*/.batch.json"))) < 8
    assert run(takes, cut, "--calibration", str(rig))[0] == 0
    assert contents(cut) == contents(whole)
