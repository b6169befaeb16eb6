"""Damaged videos and crashing decoders, in the service and on the command line."""

import json
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import psutil
import pytest
from typer.testing import CliRunner

from api.cli.main import app
from pipeline.calibration.write import encode
from pipeline.core.errors import ModelError
from pipeline.detection import models
from tests.e2e.serving import Served, serving
from tests.pipeline.conftest import ring_camera
from tests.pipeline.media import rewrite_packets, write_sizes, write_video
from tests.pipeline.video.test_damage import lose
from tests.waiting import wait_for

DECODER = "pipeline.video.decode_process"

# The name of the file chooses how the decoder fails.
CHILDREN = """
import json, os, signal, sys, time
from pathlib import Path
if "pipeline.video.decode_process" in sys.orig_argv:
    import av
    name = Path(json.loads(sys.orig_argv[-2])["path"]).name
    open_file = av.open
    def act(*arguments, **options):
        if name == "crash.mp4":
            os.kill(os.getpid(), signal.SIGSEGV)
        if name == "hang.mp4":
            time.sleep(600)
        if name == "twice.mp4":
            # In the check of the session's pictures, and in the job.
            marks = Path(__file__).with_name("was killed")
            num_killed = marks.stat().st_size if marks.exists() else 0
            if num_killed < 2:
                marks.write_bytes(bytes(num_killed + 1))
                os.kill(os.getpid(), signal.SIGKILL)
        return open_file(*arguments, **options)
    av.open = act
"""


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    for detector in ("movenet-multipose", "openpose-mobilenet-thin"):
        try:
            models.verify(detector)
        except ModelError:
            pytest.skip(f"{detector} is not installed")
    folder = tmp_path_factory.mktemp("children")
    (folder / "sitecustomize.py").write_text(CHILDREN, encoding="utf-8")
    with serving(tmp_path_factory.mktemp("data"), 1, PYTHONPATH=str(folder)) as running:
        yield running


def capture(folder: Path, name: str, lost: range = range(0), num_frames: int = 60) -> list[Path]:
    """Two videos of an empty room with their calibration; some frames of the first video can't be decoded."""
    cameras = [replace(ring_camera(one, angle), size_px=(64, 48)) for one, angle in ((name, 0.3), ("right", 1.9))]
    good = write_video(folder / "good.mkv", num_frames, codec="mpeg4", options={"g": "10"})
    rewrite_packets(good, folder / f"{name}.mp4", lose(*lost))
    write_video(folder / "right.mp4", num_frames)
    good.unlink()
    (folder / "calibration.json").write_bytes(encode(cameras))
    return [folder / f"{name}.mp4", folder / "right.mp4", folder / "calibration.json"]


def post(service: Served, paths: list[Path], **spec: Any) -> str:
    with ExitStack() as opened:
        fields = ("videos", "videos", "calibration")
        files = [
            (field, (path.name, opened.enter_context(path.open("rb"))))
            for field, path in zip(fields, paths, strict=True)
        ]
        answer = service.client.post("/v1/jobs", files=files, data={"spec": json.dumps(spec)})
    assert answer.status_code == 202, answer.text
    return str(answer.json()["id"])


def decoders(service: Served) -> list[psutil.Process]:
    found = []
    for process in service.tree():
        with suppress(psutil.NoSuchProcess):
            found += [process] if DECODER in process.cmdline() else []
    return found


@pytest.mark.parametrize(
    "spec", [{}, {"method": "clustering", "detector": "openpose-mobilenet-thin"}, {"frame_range": [15, 55]}]
)
def test_damaged_frames_are_told_in_job_and_its_results(service: Served, tmp_path: Path, spec: dict[str, Any]) -> None:
    job = service.wait_for_end(post(service, capture(tmp_path, "left", range(20, 23)), **spec))
    assert job["state"] == "succeeded", job
    num_frames = 40 if "frame_range" in spec else 60
    (told,) = [one for one in job["warnings"] if one["code"] == "damaged_video"]
    assert f"left.mp4 (3 of {num_frames} frames, from 0.8 to 0.9 s)" in told["message"]
    metrics = service.client.get(f"/v1/jobs/{job['id']}/results/metrics.json").json()
    assert told in metrics["capture_checks"]


def test_too_many_damaged_frames_end_job(service: Served, tmp_path: Path) -> None:
    job = service.wait_for_end(post(service, capture(tmp_path, "left", range(20, 29))))
    assert job["state"] == "failed"
    assert (job["error"]["code"], job["error"]["camera"]) == ("video_damaged", "left")
    assert "left.mp4: 9 of 60 frames are damaged" in job["error"]["detail"]
    assert not job["error"]["retryable"]


def test_video_that_kills_its_decoder_ends_job_at_once(service: Served, tmp_path: Path) -> None:
    job = service.wait_for_end(post(service, capture(tmp_path, "crash")))
    assert (job["state"], job["error"]["code"], job["error"]["camera"]) == ("failed", "video_unreadable", "crash")
    assert job["error"]["detail"].startswith("crash.mp4: Frame 0 of 60 could not be decoded within the limits")
    assert not job["error"]["retryable"]
    wait_for(lambda: decoders(service) == [])


def test_decoder_that_is_killed_from_outside_is_tried_again(service: Served, tmp_path: Path) -> None:
    job = service.wait_for_end(post(service, capture(tmp_path, "twice")))
    assert job["state"] == "succeeded", job
    (attempt,) = service.client.get(f"/v1/jobs/{job['id']}/attempts").json()["attempts"]
    assert "SIGKILL" in json.dumps(attempt)


def test_job_whose_decoder_hangs_is_canceled_within_seconds(service: Served, tmp_path: Path) -> None:
    job_id = post(service, capture(tmp_path, "hang"))
    wait_for(lambda: bool(decoders(service)))
    service.client.post(f"/v1/jobs/{job_id}/cancel").raise_for_status()
    asked_s = time.monotonic()
    wait_for(lambda: service.job(job_id)["state"] == "canceled")
    wait_for(lambda: decoders(service) == [])
    assert time.monotonic() - asked_s < 30


@pytest.mark.parametrize("processes", [1, 2])
def test_command_line_tells_same(tmp_path: Path, processes: int) -> None:
    def run(folder: Path, lost: range) -> dict[str, Any]:
        folder.mkdir()
        *_, calibration = capture(folder, "left", lost)
        options = [f"--videos={folder}", f"--calibration={calibration}", f"--processes={processes}"]
        result = CliRunner().invoke(app, ["reconstruct", *options, f"--out={folder / 'out'}", "--json"])
        assert (result.exit_code == 0) == (len(lost) < 6), result.output
        return dict(json.loads(result.stdout))

    run(tmp_path / "few", range(20, 23))
    metrics = json.loads((tmp_path / "few" / "out" / "metrics.json").read_bytes())
    assert "damaged_video" in [one["code"] for one in metrics["capture_checks"]]
    (problem,) = run(tmp_path / "many", range(20, 29))["problems"]
    assert (problem["code"], problem["file"], problem["camera"]) == ("video_damaged", "left.mp4", "left")


@pytest.mark.parametrize("processes", [1, 2])
def test_video_that_changes_its_size_is_refused_on_command_line(tmp_path: Path, processes: int) -> None:
    """The error of a detection process names the file."""
    video, _, calibration = capture(tmp_path, "left")
    video.unlink()
    write_sizes(tmp_path / "left.avi", [(64, 48), (96, 64), (64, 48)], 20, "mpeg4")
    options = [f"--videos={tmp_path}", f"--calibration={calibration}", f"--processes={processes}"]
    result = CliRunner().invoke(app, ["reconstruct", *options, f"--out={tmp_path / 'out'}", "--json"])
    assert result.exit_code == 2
    (problem,) = json.loads(result.stdout)["problems"]
    assert (problem["code"], problem["file"], problem["camera"]) == ("video_changes_size", "left.avi", "left")
