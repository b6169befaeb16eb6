"""`multicap serve`: the sample capture from POST to BVH, while parts of the service are killed."""

import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import httpx2
import pytest

from api.cli.served import READY
from pipeline.core.runtime.packages.samples import Sample
from tests.e2e.conftest import NUM_FIRST
from tests.e2e.serving import COMMAND, NUM_PROCESSES, Served, digests
from tests.waiting import is_alive, wait_for

pytestmark = pytest.mark.xdist_group("service")


def test_cancel_retry_and_kill_give_library_files(served: Served, sample: Sample, first_results: Path) -> None:
    job_id = served.post(sample, frame_range=[0, NUM_FIRST])
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
    assert served.downloads(job_id) == digests(first_results)

    spec = {"frame_range": [0, NUM_FIRST]}
    again = served.client.post(f"/v1/sessions/{job['session_id']}/jobs", json=spec).raise_for_status().json()
    stages = served.wait_for_end(again["id"])["stages"]
    assert {stage["name"]: stage["reused"] for stage in stages} == {
        "look": True,
        "detect": True,
        "check_session": True,
        "associate": True,
        "expect_bodies": True,
        "redetect": True,
        "identify": True,
        "fit": True,
        "hold_feet": True,
        "export": False,
    }
    assert served.downloads(again["id"]) == digests(first_results)
    stored = served.data_dir / "artifacts"
    outputs = stored / "sessions" / job["session_id"] / "stages"
    folders = (outputs, stored / "jobs" / job_id)
    used_bytes = sum(file.stat().st_size for folder in folders for file in folder.rglob("*") if file.is_file())
    assert 0.7 < job["space"]["store_bytes"] / used_bytes < 1.5


def test_killed_worker_and_killed_broker_change_no_byte(served: Served, sample: Sample, first_results: Path) -> None:
    job_id = served.post(sample, frame_range=[0, NUM_FIRST])
    wait_for(lambda: served.job(job_id)["progress"] > 0.1)
    served.part("worker").kill()
    wait_for(lambda: served.job(job_id)["progress"] > 0.3)
    served.part("valkey-server").kill()
    assert served.wait_for_end(job_id)["state"] == "succeeded"
    assert served.downloads(job_id) == digests(first_results)


def test_second_service_on_folder_is_refused(served: Served) -> None:
    second = subprocess.run(
        [*COMMAND, "--port", "0", "--data", str(served.data_dir)],
        capture_output=True,
        text=True,
        timeout=180,
        check=False,
    )
    assert second.returncode == 2
    assert "Another service runs on" in second.stderr
    assert "Traceback" not in second.stderr
    assert served.client.get("/readyz").is_success


def test_port_that_is_taken_is_refused(served: Served, tmp_path: Path) -> None:
    port = str(served.client.base_url.port)
    command = [*COMMAND, "--port", port, "--data", str(tmp_path)]
    refused = subprocess.run(command, capture_output=True, text=True, timeout=180, check=False)
    assert refused.returncode == 2
    assert f"Port {port} can't be used on" in refused.stderr


def test_killed_api_comes_back_on_its_port(served: Served) -> None:
    served.part("api").kill()
    # A new connection waits at the socket until the new process accepts it.
    assert httpx2.get(served.client.base_url.join("/healthz"), timeout=180, trust_env=False).is_success
    wait_for(lambda: len(served.tree()) == NUM_PROCESSES)


def test_killed_service_leaves_no_orphan(tmp_path: Path) -> None:
    command = [*COMMAND, "--port", "0", "--data", str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process, httpx2.Client() as client:
        service = Served(process, tmp_path, client)
        try:
            assert process.stdout is not None
            assert process.stdout.readline().startswith(READY)
            # The worker forks its children a while after the API answers.
            wait_for(lambda: len(service.tree()) == NUM_PROCESSES)
            tree = service.tree()
        finally:
            process.kill()
    wait_for(lambda: not any(is_alive(one) for one in tree), timeout_s=120)


def test_command_that_refusal_names_lets_service_start(tmp_path: Path) -> None:
    """The data folder is not the default folder, and a shell would split its name."""
    data = tmp_path / "a folder"
    # A loopback address, by a name that the service does not know.
    serve = [*COMMAND, "--host", "127.1", "--port", "0", "--data", str(data)]
    refused = subprocess.run(serve, capture_output=True, text=True, timeout=120, check=False)
    assert refused.returncode == 2
    (named,) = re.findall(r"`multicap (keys create NAME.*?)`", refused.stderr)
    assert shlex.split(named)[-2:] == ["--data", str(data)]
    create = [sys.executable, "-m", "api.cli.main", *shlex.split(named), "--json"]
    subprocess.run(create, capture_output=True, timeout=120, check=True)
    with subprocess.Popen(serve, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline().startswith(READY)
        finally:
            process.send_signal(signal.SIGINT)
