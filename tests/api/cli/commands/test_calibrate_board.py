"""Command ``multicap calibrate board``: times of frames from a file."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from api.cli.commands.calibrate.board import timed
from api.cli.main import app
from api.cli.sources import SourceOptions
from pipeline.capture.session import CaptureSession
from pipeline.core.errors import InputError
from tests.pipeline.media import write_video

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


def test_frames_have_the_times_of_the_file(session: CaptureSession, tmp_path: Path) -> None:
    found = timed(session, table(tmp_path / "times.csv", ("left", "right")))
    for camera, times_s in TIMES_S.items():
        np.testing.assert_allclose(found.times[camera].time_s, times_s)
    assert 5.0 < found.timebase.frame_rate_hz < 7.0


def test_a_camera_without_times_is_named(session: CaptureSession, tmp_path: Path) -> None:
    with pytest.raises(InputError) as raised:
        timed(session, table(tmp_path / "times.csv", ("left",)))
    (problem,) = raised.value.problems
    assert (problem.code, problem.camera) == ("timestamps_missing", "right")


def test_timestamps_replace_offsets(tmp_path: Path) -> None:
    options = ["--board", "chessboard:9x6:0.06", "--videos", str(tmp_path), "--out", str(tmp_path / "rig.toml")]
    result = CliRunner().invoke(app, ["calibrate", "board", *options, "--timestamps", "t.csv", "--offset", "left=0.1"])
    assert result.exit_code == 2
    assert "either --timestamps, or --offset and --rate" in " ".join(result.output.split())
