"""`multicap calibrate`: from a board, from people, and from known points of a scene."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from api.cli.commands.calibrate import timed
from api.cli.main import app
from api.cli.sources import SourceOptions
from pipeline.calibration.registry import read_calibration
from pipeline.calibration.write import encode
from pipeline.capture.session import CaptureSession
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import InputError
from pipeline.geometry.camera import project
from pipeline.validation.evaluation.camera_errors import camera_errors
from pipeline.validation.simulation.motion.director import Cast
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras
from pipeline.validation.simulation.scenes import Scene, record
from tests.pipeline.media import write_video
from tests.pipeline.simulations import write_simulation

TIMES_S = {"left": [0.0, 0.17, 0.32, 0.51], "right": [0.01, 0.16, 0.34, 0.5]}


@pytest.fixture
def session(tmp_path: Path) -> CaptureSession:
    for camera in TIMES_S:
        write_video(tmp_path / f"{camera}.mp4", 4)
    return SourceOptions([tmp_path]).open_videos(None, keeps_poses=False)


def table(path: Path, cameras: tuple[str, ...]) -> Path:
    rows = [f"{camera},{frame},{time_s}" for camera in cameras for frame, time_s in enumerate(TIMES_S[camera])]
    path.write_text("\n".join(["camera,frame,time_s", *rows]))
    return path


def test_frames_have_times_of_file(session: CaptureSession, tmp_path: Path) -> None:
    found = timed(session, table(tmp_path / "times.csv", ("left", "right")))
    for camera, times_s in TIMES_S.items():
        np.testing.assert_allclose(found.times[camera].time_s, times_s)
    assert 5.0 < found.timebase.frame_rate_hz < 7.0


def test_timestamps_camera_missing_is_named(session: CaptureSession, tmp_path: Path) -> None:
    with pytest.raises(InputError) as raised:
        timed(session, table(tmp_path / "times.csv", ("left",)))
    (problem,) = raised.value.problems
    assert (problem.code, problem.camera) == ("timestamps_missing", "right")


def test_timestamps_replace_offsets(tmp_path: Path) -> None:
    options = ["--board", "chessboard:9x6:0.06", "--videos", str(tmp_path), "--out", str(tmp_path / "rig.toml")]
    result = CliRunner().invoke(app, ["calibrate", "board", *options, "--timestamps", "t.csv", "--offset", "left=0.1"])
    assert result.exit_code == 2
    assert "either --timestamps, or --offset and --rate" in " ".join(result.output.split())


runner = CliRunner()


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files of two people who walk about before three cameras."""
    folder = tmp_path_factory.mktemp("capture")
    write_simulation(
        record(Scene(Rig(Layout.RING, 3, (4.0, 4.0), 2.2), Cast(2, (3.0, 3.0)), duration_s=15.0), 3), folder
    )
    return folder


def given(capture: Path) -> list[str]:
    """Options that name the files of a capture."""
    return [
        "--keypoints", str(capture / "keypoints"), "--timestamps", str(capture / "timestamps.csv"),
        "--intrinsics", str(capture / "calibration.json"), "--stature-m", "1.7",
    ]  # fmt: skip


@pytest.mark.slow
def test_keypoints_give_calibration_and_report(capture: Path, tmp_path: Path) -> None:
    out = tmp_path / "room.toml"
    arguments = [
        "calibrate",
        "people",
        *given(capture),
        "--out",
        str(out),
        "--report",
        str(tmp_path / "report"),
        "--json",
    ]
    result = runner.invoke(app, arguments)
    assert result.exit_code == 0, result.output
    errors = camera_errors(read_calibration(capture / "calibration.json"), read_calibration(out))
    assert errors["rotation_deg"] < 0.5
    assert errors["translation_mm"] < 40.0
    document = json.loads(result.stdout)
    assert document["file"] == str(out)
    assert document["world"].startswith("Z up")
    assert json.loads((tmp_path / "report" / "report.json").read_bytes())["cameras"] == document["cameras"]


def scene_table(path: Path, cameras: Sequence[Camera], num_points: int = 8) -> list[str]:
    """Table of the corners of two boxes, and the options that name it."""
    corners_m = [(x, y, z + 0.2 * x) for x in (0.0, 0.8) for y in (0.0, 0.6) for z in (0.3, 1.2)][:num_points]
    lines = ["name,x_m,y_m,z_m,camera,x_px,y_px"]
    for camera in cameras:
        for number, point_m in enumerate(corners_m):
            x_px, y_px = project(camera, np.array(point_m)).tolist()
            lines.append(f"P{number},{','.join(map(str, point_m))},{camera.name},{x_px},{y_px}")
    path.write_text("\n".join(lines))
    return ["calibrate", "scene", "--points", str(path)]


def test_scene_gives_calibration_and_error_of_each_point(tmp_path: Path) -> None:
    cameras = build_cameras(Rig(Layout.RING, 3, (3.0, 2.5), 2.0), np.random.default_rng(0))
    lenses, out = tmp_path / "lenses.json", tmp_path / "rig.toml"
    lenses.write_bytes(encode(cameras))
    words = scene_table(tmp_path / "points.csv", cameras)
    result = runner.invoke(app, [*words, "--intrinsics", str(lenses), "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert [line.split() for line in result.stdout.splitlines() if line.startswith("P7")] == [
        ["P7", "0.0", "0.0", "0.0"]
    ]
    assert camera_errors(read_calibration(lenses), read_calibration(out))["translation_mm"] < 0.01
    result = runner.invoke(app, [*words, "--size=1280x720", "--out", str(out), "--json"])
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    assert "Lenses are estimated" in document["world"]
    assert camera_errors(read_calibration(lenses), read_calibration(out))["translation_mm"] < 150.0
    assert len(document["cameras"][2]["points"]) == 8


def test_scene_problems_are_named_at_once(tmp_path: Path) -> None:
    cameras = build_cameras(Rig(Layout.RING, 2, (3.0, 2.5), 2.0), np.random.default_rng(0))
    words = [*scene_table(tmp_path / "points.csv", cameras, 5), "--out", str(tmp_path / "rig.json"), "--json"]
    problems = {
        size: [
            (problem["code"], problem["camera"])
            for problem in json.loads(runner.invoke(app, [*words, *size]).stdout)["problems"]
        ]
        for size in ((), ("--size=1280x720",), ("--size=big", "--size=cam_00=0x1"))
    }
    assert problems == {
        (): [("invalid_size", "cam_00"), ("invalid_size", "cam_01")],
        ("--size=1280x720",): [("known_points_few", "cam_00"), ("known_points_few", "cam_01")],
        ("--size=big", "--size=cam_00=0x1"): [("parameter_unreadable", None)] * 2,
    }
    assert not (tmp_path / "rig.json").exists()


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--stature-m", "1.7"], "A capture has either videos or keypoints."),
        (["--stature-m", "1.7", "--keypoints", "K"], "Give --intrinsics too."),
        (["--stature-m", "1.7", "--videos", "V", "--timestamps", "T"], "Omit --timestamps."),
        (["--stature-m", "178", "--videos", "V"], "2.6"),
    ],
)
def test_sources_missing_or_superfluous_are_named(options: list[str], expected: str, tmp_path: Path) -> None:
    result = runner.invoke(app, ["calibrate", "people", *options, "--out", str(tmp_path / "room.json")])
    assert result.exit_code == 2
    assert expected in result.stderr
    assert "Traceback" not in result.stderr
