"""`multicap check`: findings of keypoint sessions, their exit codes, and problems as findings."""

import json
import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from api.cli.main import app
from pipeline.capture.pictures.sample_pictures import NUM_PICTURES
from pipeline.validation.simulation.motion.script import Gesture
from pipeline.validation.simulation.scenes import find_scene, record
from tests.pipeline.capture.pictures.rooms import walk
from tests.pipeline.capture.synchronization.conftest import alone
from tests.pipeline.capture.test_session import calibration
from tests.pipeline.media import write_pictures
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


def test_nothing_is_wrong_with_good_session(session: Path) -> None:
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


@pytest.mark.slow
def test_clocks_are_measured_if_asked(session: Path, tmp_path: Path) -> None:
    names = [camera.name for camera in SIMULATION.cameras]
    late = 5
    rows = (session / "timestamps.csv").read_text().splitlines()
    moved = [rows[0]]
    for camera, frame, time_s in (row.split(",") for row in rows[1:]):
        moved.append(f"{camera},{frame},{float(time_s) + (late / 25.0 if camera == names[1] else 0.0)}")
    times = tmp_path / "timestamps.csv"
    times.write_text("\n".join(moved))
    code, findings = checked(session, session / "calibration.json", timestamps=str(times))
    assert (code, {one["code"] for one in findings}) == (0, {"clocks_disagree"})
    code, findings = checked(session, session / "calibration.json", timestamps=str(times), sync="auto")
    measured = {one["camera"]: one for one in findings if one["code"] == "clock_measured"}
    assert code == 0
    assert len(measured) == len(findings) == len(names)
    offsets_s = {name: one["evidence"]["offset_s"] for name, one in measured.items()}
    assert offsets_s[names[1]] - offsets_s[names[0]] == pytest.approx(-late / 25.0, abs=0.01)


def test_clocks_that_are_not_certain_are_error(tmp_path: Path) -> None:
    write_simulation(record(alone(Gesture.IDLE, 4.0), 4, 3), tmp_path)
    code, findings = checked(tmp_path, tmp_path / "calibration.json", sync="auto")
    assert code == 2
    assert {(one["code"], one["severity"]) for one in findings} == {("sync_no_motion", "error")}


def test_unknown_synchronization_is_refused(session: Path) -> None:
    words = ["check", "--keypoints", str(session), "--calibration", str(session / "calibration.json")]
    answer = CliRunner().invoke(app, [*words, "--sync", "guess", "--json"])
    assert answer.exit_code == 2
    (problem,) = json.loads(answer.stdout)["problems"]
    assert (problem["field"], problem["message"]) == ("sync", "sync must be one of declared, auto.")


@pytest.mark.slow
def test_thumbnails_of_videos_are_written(tmp_path: Path) -> None:
    bright = walk(0, 30)
    for name, images in {"left": bright, "right": [image // 8 for image in walk(1, 30)]}.items():
        write_pictures(tmp_path / f"{name}.mp4", images)
    rig = calibration(tmp_path / "rig.json", ["left", "right"], (320, 180))
    words = ["check", "--videos", str(tmp_path / "left.mp4"), "--videos", str(tmp_path / "right.mp4")]
    thumbnails = tmp_path / "small"
    answer = CliRunner().invoke(app, [*words, "--calibration", str(rig), "--thumbnails", str(thumbnails), "--json"])
    findings = json.loads(answer.stdout)["findings"]
    dark = next(one for one in findings if one["code"] == "picture_dark")
    assert (answer.exit_code, dark["camera"]) == (0, "right")
    # A place may be empty.
    assert [finding["severity"] for finding in findings if finding["code"] == "nobody_detected"] == ["warning"]
    shown = {path.name: np.asarray(cv2.imread(str(path))).mean() for path in thumbnails.iterdir()}
    assert set(shown) == {f"{name}-{number}.jpg" for name in ("left", "right") for number in range(NUM_PICTURES)}
    assert all(
        shown[f"right-{number}.jpg"] < 40 < shown[f"left-{number}.jpg"] for number in dark["evidence"]["pictures"]
    )


@pytest.mark.slow
def test_check_errors_refuse_reconstruct_and_batch_unless_forced(session: Path, tmp_path: Path) -> None:
    def exchange(cameras: list[Any]) -> None:
        cameras[0]["name"], cameras[1]["name"] = cameras[1]["name"], cameras[0]["name"]

    rig = written(session, tmp_path, exchange)
    _, findings = checked(session, rig)
    files = ["--keypoints", str(session / "keypoints"), "--timestamps", str(session / "timestamps.csv")]
    line = ["reconstruct", *files, "--calibration", str(rig), "--exports", "csv", "--no-cache"]
    refused = CliRunner().invoke(app, [*line, "--out", str(tmp_path / "a"), "--json"])
    said = [
        (finding["code"], finding["camera"], finding["message"]) for finding in json.loads(refused.stdout)["problems"]
    ]
    assert refused.exit_code == 2
    assert said == [(finding["code"], finding["camera"], finding["message"]) for finding in findings]
    spoken = CliRunner().invoke(app, [*line, "--out", str(tmp_path / "a")])
    assert (spoken.exit_code, spoken.stdout) == (2, "")
    assert spoken.stderr.count("cameras or videos are exchanged") == 2
    assert "--force" in spoken.stderr
    assert not list((tmp_path / "a").glob("*"))
    forced = CliRunner().invoke(app, [*line, "--out", str(tmp_path / "b"), "--force", "--json"])
    assert (forced.exit_code, json.loads(forced.stdout)["forced"]) == (0, ["cameras_exchanged"])
    assert json.loads((tmp_path / "b" / "metrics.json").read_bytes())["forced"] == ["cameras_exchanged"]
    takes = tmp_path / "takes"
    shutil.copytree(session, takes / "walk", ignore=shutil.ignore_patterns("calibration.json"))
    batch = ["batch", str(takes), "--calibration", str(rig), "--exports", "csv", "--json", "--out", str(tmp_path / "c")]
    answer = CliRunner().invoke(app, batch)
    (row,) = json.loads(answer.stdout)["takes"]
    assert (answer.exit_code, row["state"]) == (1, "failed")
    assert "cameras or videos are exchanged" in row["message"]
    assert "--force" in row["message"]
    answer = CliRunner().invoke(app, [*batch, "--force"])
    (row,) = json.loads(answer.stdout)["takes"]
    assert (answer.exit_code, row["state"]) == (0, "done")


@pytest.mark.slow
def test_folders_of_keypoints_are_stated_for_cameras(session: Path, tmp_path: Path) -> None:
    words = [
        "check",
        "--timestamps",
        str(session / "timestamps.csv"),
        "--calibration",
        str(session / "calibration.json"),
    ]
    names = [camera.name for camera in SIMULATION.cameras]
    folders = {}
    for number, name in enumerate(names):
        folders[name] = shutil.copytree(session / "keypoints" / name, tmp_path / f"folder {number}")

    def run(*stated: str) -> tuple[int, Any]:
        answer = CliRunner().invoke(
            app, [*words, "--json", *(word for pair in stated for word in ("--keypoints", pair))]
        )
        document = json.loads(answer.stdout)
        return answer.exit_code, document.get("findings", document.get("problems"))

    assert run(*(f"{name}={folder}" for name, folder in folders.items())) == (0, [])
    turned = [f"{name}={folders[other]}" for name, other in zip(names, [*names[1:], names[0]], strict=True)]
    code, findings = run(*turned)
    assert (code, {finding["code"] for finding in findings}) == (2, {"cameras_exchanged"})
    code, findings = run(
        f"{names[0]}={folders[names[0]]}", f"{names[0]}={folders[names[1]]}", str(session / "keypoints")
    )
    assert (code, [finding["code"] for finding in findings]) == (2, ["camera_with_two_folders", "sources"])
