"""Time of the check of a session's files: four cameras, five minutes, on two cores."""

import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pipeline.core.runtime.child_processes import module_command
from tests.pipeline.capture.test_session import calibration

pytestmark = pytest.mark.benchmark

NAMES = [f"cam_{number}" for number in range(4)]
# Views of the four cameras, so that they differ.
FILTERS = ("null", "hflip", "vflip", "hflip,vflip")
LOOP_S, NUM_LOOPS = 4, 75


@pytest.fixture(scope="module")
def videos(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Videos of 1920 x 1080 pixels at 25 Hz with 8 Mbit/s, a keyframe every two seconds: four seconds, looped."""
    if shutil.which("ffmpeg") is None:
        pytest.skip("ffmpeg is not installed")
    folder = tmp_path_factory.mktemp("videos")
    paths = [folder / f"{name}.mp4" for name in NAMES]
    for path, view in zip(paths, FILTERS, strict=True):
        loop = folder / f"loop-{path.name}"
        source = ["-f", "lavfi", "-i", "testsrc2=size=1920x1080:rate=25", "-t", str(LOOP_S)]
        noise = ["-vf", f"{view},noise=alls=12:allf=t", "-pix_fmt", "yuv420p", "-g", "50"]
        rate = ["-b:v", "8M", "-maxrate", "8M", "-bufsize", "8M", "-c:v", "libx264", "-preset", "ultrafast"]
        subprocess.run(["ffmpeg", "-v", "error", *source, *noise, *rate, loop], check=True)
        again = ["-stream_loop", str(NUM_LOOPS - 1), "-i", str(loop), "-c", "copy"]
        subprocess.run(["ffmpeg", "-v", "error", *again, path], check=True)
    return paths


def test_four_cameras_and_five_minutes_take_twenty_seconds(
    tmp_path: Path, videos: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    rig = calibration(tmp_path / "calibration.json", NAMES, (1920, 1080))
    written = ["--record", str(tmp_path / "record"), "--thumbnails", str(tmp_path)]
    words = ["--videos", *map(str, videos), "--calibration", str(rig), *written]
    cores = sorted(os.sched_getaffinity(0))[:2]
    start_s = time.monotonic()
    ended = subprocess.run(
        module_command("pipeline.capture.preflight", *words),
        capture_output=True,
        check=True,
        preexec_fn=lambda: os.sched_setaffinity(0, cores),
    )
    took_s = time.monotonic() - start_s
    with capsys.disabled():
        sys.stdout.write(f"\n{took_s:.1f} s for 4 cameras x 5 minutes\n")
    answer = json.loads(ended.stdout)
    assert [camera["num_frames"] for camera in answer["cameras"]] == [7500] * 4
    assert [len(camera["thumbnails"]) for camera in answer["cameras"]] == [8] * 4
    assert took_s <= 20.0
