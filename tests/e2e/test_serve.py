"""`multicap serve` as a process: the real sample from POST to BVH, while parts of it are killed."""

import hashlib
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx2
import psutil
import pytest

from pipeline.samples import Sample

pytestmark = [
    pytest.mark.xdist_group("sample"),
    pytest.mark.skipif(sys.platform != "linux", reason="ties children to parents"),
]

COMMAND = [sys.executable, "-c", "from api.cli import main; main()", "serve", "--port", "0", "--workers", "2"]
# The supervisor, broker, worker with its two children, reaper and API.
NUM_PROCESSES = 7
READY = "Multicap is ready at "


@dataclass
class Served:
    """A running service."""

    process: subprocess.Popen[str]
    data_dir: Path
    client: httpx2.Client

    def tree(self) -> list[psutil.Process]:
        supervisor = psutil.Process(self.process.pid)
        return [supervisor, *supervisor.children(recursive=True)]

    def part(self, word: str) -> psutil.Process:
        """The child of the supervisor whose command line has a word."""
        (found,) = [one for one in psutil.Process(self.process.pid).children() if word in one.cmdline()]
        return found

    def post(self, sample: Sample) -> str:
        with ExitStack() as opened:
            files = [("videos", (path.name, opened.enter_context(path.open("rb")))) for path in sample.videos.values()]
            calibration = (
                "calibration",
                (sample.calibration.name, opened.enter_context(sample.calibration.open("rb"))),
            )
            response = self.client.post("/v1/jobs", files=[*files, calibration])
        assert response.status_code == 202, response.text
        return str(response.json()["id"])

    def job(self, job_id: str) -> dict[str, Any]:
        return dict(self.client.get(f"/v1/jobs/{job_id}").raise_for_status().json())

    def downloads(self, job_id: str) -> dict[str, str]:
        """SHA-256 of each result file as downloaded."""
        listed = self.client.get(f"/v1/jobs/{job_id}/results").raise_for_status().json()["results"]
        contents = {
            one["name"]: self.client.get(f"/v1/jobs/{job_id}/results/{one['name']}").raise_for_status().content
            for one in listed
        }
        found = {name: hashlib.sha256(content).hexdigest() for name, content in contents.items()}
        assert found == {one["name"]: one["sha256"] for one in listed}
        return found

    def wait_for_end(self, job_id: str) -> dict[str, Any]:
        wait_for(lambda: self.job(job_id)["state"] in {"succeeded", "failed", "canceled"}, timeout_s=240)
        return self.job(job_id)


def wait_for(condition: Callable[[], bool], timeout_s: float = 60.0) -> None:
    deadline_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline_s, "nothing happened in time"
        time.sleep(0.1)


def is_alive(process: psutil.Process) -> bool:
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def digests(folder: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """The service, and in the end that Ctrl-C leaves no process of it."""
    data_dir = tmp_path_factory.mktemp("data")
    with subprocess.Popen([*COMMAND, "--data", str(data_dir)], stdout=subprocess.PIPE, text=True) as process:
        tree: list[psutil.Process] = []
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            assert line.startswith(READY)
            with httpx2.Client(base_url=line.removeprefix(READY).strip(), timeout=60.0, trust_env=False) as client:
                running = Served(process, data_dir, client)
                yield running
                tree = running.tree()
        finally:
            process.send_signal(signal.SIGINT)
            status = process.wait(30)
    assert status == 0
    assert len(tree) == NUM_PROCESSES
    assert not any(is_alive(one) for one in tree)


def test_cancel_retry_and_a_killed_worker_process_give_the_library_s_files(
    served: Served, sample: Sample, results: Path
) -> None:
    job_id = served.post(sample)
    wait_for(lambda: served.job(job_id)["progress"] > 0)
    served.client.post(f"/v1/jobs/{job_id}/cancel").raise_for_status()
    asked_s = time.monotonic()
    wait_for(lambda: served.job(job_id)["state"] == "canceled")
    assert time.monotonic() - asked_s < 5

    served.client.post(f"/v1/jobs/{job_id}/retry").raise_for_status()
    wait_for(lambda: served.job(job_id)["progress"] > 0)
    served.part("worker").children()[0].kill()
    progress = []
    while (job := served.job(job_id))["state"] == "running":
        progress.append(job["progress"])
        time.sleep(0.2)
    assert (job["state"], job["attempt"]) == ("succeeded", 2), job
    assert progress == sorted(progress)
    assert served.downloads(job_id) == digests(results)

    again = served.client.post(f"/v1/sessions/{job['session_id']}/jobs").raise_for_status().json()
    stages = served.wait_for_end(again["id"])["stages"]
    assert {stage["name"]: stage["reused"] for stage in stages} == {
        "detect": True,
        "associate": True,
        "fit": True,
        "export": False,
    }
    assert served.downloads(again["id"]) == digests(results)


def test_a_second_service_on_the_folder_is_refused(served: Served) -> None:
    second = subprocess.run(
        [*COMMAND, "--data", str(served.data_dir)], capture_output=True, text=True, timeout=60, check=False
    )
    assert second.returncode == 2
    assert "Another service runs on" in second.stderr
    assert "Traceback" not in second.stderr
    assert served.client.get("/readyz").is_success


def test_a_port_that_is_taken_is_refused(served: Served, tmp_path: Path) -> None:
    port = str(served.client.base_url.port)
    command = [*COMMAND[:4], "--port", port, "--data", str(tmp_path)]
    refused = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert refused.returncode == 2
    assert f"Port {port} can't be had" in refused.stderr


def test_a_killed_api_comes_back_on_its_port(served: Served) -> None:
    served.part("api").kill()
    # A new connection waits at the socket until the new process takes it.
    assert httpx2.get(served.client.base_url.join("/healthz"), timeout=30.0, trust_env=False).is_success
    wait_for(lambda: len(served.tree()) == NUM_PROCESSES)
