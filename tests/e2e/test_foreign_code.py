"""Modules in the current folder with the names of Multicap's modules or dependencies are never run."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import httpx2
import pytest

from api.cli.served import READY
from api.web.settings import Settings
from pipeline.video.info import VideoInfo
from pipeline.video.probe_process import probe_in_children
from tests.api.conftest import NO_BROKER, running
from tests.e2e.captures import keypoint_capture, video_capture
from tests.e2e.serving import Served
from tests.e2e.test_serve_keypoints import files
from tests.pipeline.media import write_video

# Started as by a user: the search path has the script's folder, and the current folder only in child processes.
MULTICAP = str(Path(sys.executable).with_name("multicap"))
# Python itself imports the last names when a process of a pool starts, or later.
NAMES = ("pipeline", "worker", "api", "numpy", "av", "celery", "alembic", "queue", "socket", "struct", "random")


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    """Folder with such modules; each module writes a file there when it is run."""
    folder = tmp_path / "foreign"
    folder.mkdir()
    for name in NAMES:
        text = f"open({str(folder / (name + '.ran'))!r}, 'w').close()\nraise SystemExit('foreign code')\n"
        (folder / f"{name}.py").write_text(text, encoding="utf-8")
    return folder


def ran(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.glob("*.ran"))


def reconstruct(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [MULTICAP, "reconstruct", "--json", *options]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300, check=False)


def test_reconstruct_keypoints(foreign: Path, tmp_path: Path) -> None:
    done = reconstruct(foreign, *keypoint_capture(tmp_path / "capture"), f"--out={tmp_path / 'out'}")
    assert (done.returncode, ran(foreign)) == (0, []), done.stderr
    assert len(json.loads(done.stdout)["tracks"]) >= 2


@pytest.mark.parametrize("processes", ["1", "2"])
def test_reconstruct_videos(foreign: Path, tmp_path: Path, processes: str) -> None:
    options = [*video_capture(tmp_path / "capture"), f"--out={tmp_path / 'out'}", "--chunk-frames=10"]
    done = reconstruct(foreign, *options, f"--processes={processes}")
    if "models install" in done.stdout:
        pytest.skip("the default detector is not installed")
    assert (done.returncode, ran(foreign)) == (0, []), done.stdout + done.stderr
    assert json.loads(done.stdout)["metrics"]["num_frames"] == 20


def test_probe(foreign: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(foreign)
    (found,) = probe_in_children([write_video(tmp_path / "a.mp4", 30)])
    assert isinstance(found, VideoInfo)
    assert found.num_frames == 30
    assert ran(foreign) == []


def test_preflight_of_api(foreign: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(foreign)
    video_capture(tmp_path / "capture")
    parts = [("videos", (path.name, path.read_bytes())) for path in sorted(tmp_path.glob("capture/videos/*"))]
    calibration = (tmp_path / "capture" / "calibration.json").read_bytes()
    with running(Settings(data_dir=tmp_path / "data", broker_url=NO_BROKER)) as live:
        answer = live.client.post("/v1/sessions", files=[*parts, ("calibration", ("calibration.json", calibration))])
    assert (answer.status_code, ran(foreign)) == (201, []), answer.text
    assert [camera["num_frames"] for camera in answer.json()["preflight"]["cameras"]] == [20, 20]


def test_serve_and_job(foreign: Path, tmp_path: Path) -> None:
    keypoint_capture(tmp_path / "capture")
    command = [MULTICAP, "serve", "--port", "0", "--workers", "1", "--data", str(tmp_path / "data")]
    with subprocess.Popen(command, cwd=foreign, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            if not line and process.wait(10) == 1:
                pytest.skip("the default detector is not installed")
            url = line.removeprefix(READY).strip()
            with httpx2.Client(base_url=url, timeout=180, trust_env=False) as client:
                service = Served(process, tmp_path / "data", client)
                answer = client.post("/v1/jobs", files=files(tmp_path / "capture"))
                assert answer.status_code == 202, answer.text
                job = service.wait_for_end(answer.json()["id"])
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(60)
    assert (job["state"], ran(foreign)) == ("succeeded", []), job
