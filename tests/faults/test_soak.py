"""Faults at random moments of real jobs on a real service: every job ends as it should, byte by byte.

``make soak`` runs 200 of them; ``MULTICAP_SOAK_RUNS`` and ``MULTICAP_SOAK_SEED`` say else. The seed and a run's number
decide its fault and its moment.
"""

import contextlib
import os
import random
import shutil
import signal
import sqlite3
import subprocess
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx2
import psutil
import pytest

from api.commands.reconstruct import write_results
from api.commands.serve import READY
from pipeline.config import Method, ReconstructionConfig
from pipeline.keypoints import open_keypoints
from pipeline.run import reconstruct_keypoints
from pipeline.simulation.files import simulation_files
from pipeline.simulation.scenes import find_scene, record
from tests.e2e.serving import COMMAND, NUM_PROCESSES, Served, digests, wait_for
from tests.e2e.test_serve_keypoints import files

pytestmark = pytest.mark.soak

RUNS = int(os.environ.get("MULTICAP_SOAK_RUNS", "200"))
SEED = int(os.environ.get("MULTICAP_SOAK_SEED", "0"))
METHODS: tuple[Method, ...] = ("tracking", "clustering")
# A job takes about so long: some faults come before it has begun, some after its end.
LONGEST_WAIT_S = 5.0
# Longer than a lease.
HELD_S = 5.0
END_S = 120.0
ENVIRONMENT = {"MULTICAP_LEASE_S": "3", "MULTICAP_HEARTBEAT_S": "0.5", "MULTICAP_REAP_INTERVAL_S": "1"}


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("capture")
    for name, content in simulation_files(record(replace(find_scene("room"), duration_s=6.0), 3, 4)):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return folder


@pytest.fixture(scope="module")
def undisturbed(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[Method, dict[str, str]]:
    """SHA-256 of each result file of the library."""
    session = open_keypoints(capture / "keypoints", capture / "calibration.json", capture / "timestamps.csv")
    found = {}
    for method in METHODS:
        folder = tmp_path_factory.mktemp(method)
        write_results(reconstruct_keypoints(session, ReconstructionConfig(method=method)), folder)
        found[method] = digests(folder)
    return found


@pytest.fixture(scope="module")
def disk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A small disk for the service's data, where this machine lets us have one."""
    folder = tmp_path_factory.mktemp("disk")
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=512m", "tmpfs", folder], check=False).returncode == 0
    yield folder
    if mounted:
        subprocess.run(["umount", "--lazy", folder], check=True)


@pytest.fixture(scope="module")
def served(disk: Path) -> Iterator[Served]:
    command = [*COMMAND, "--port", "0", "--data", str(disk / "data")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=os.environ | ENVIRONMENT) as process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            assert line.startswith(READY)
            url = line.removeprefix(READY).strip()
            with httpx2.Client(base_url=url, timeout=60.0, trust_env=False) as client:
                yield Served(process, disk / "data", client)
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(60)


def kill(process: psutil.Process) -> None:
    with contextlib.suppress(psutil.NoSuchProcess):
        process.kill()


def kill_worker_child(served: Served, chance: random.Random) -> None:
    kill(chance.choice(served.part("worker").children()))


def kill_worker(served: Served, chance: random.Random) -> None:
    kill(served.part("worker"))


def kill_api(served: Served, chance: random.Random) -> None:
    kill(served.part("api"))


def kill_reaper(served: Served, chance: random.Random) -> None:
    kill(served.part("worker.reaper"))


def kill_broker_with_its_data(served: Served, chance: random.Random) -> None:
    kill(served.part("valkey-server"))
    shutil.rmtree(served.data_dir / "broker" / "appendonlydir", ignore_errors=True)


def lock_database(served: Served, chance: random.Random) -> None:
    with contextlib.closing(sqlite3.connect(served.data_dir / "multicap.db", timeout=30)) as database:
        database.execute("BEGIN IMMEDIATE")
        time.sleep(HELD_S)
        database.rollback()


def freeze_worker_beyond_its_lease(served: Served, chance: random.Random) -> None:
    """Its clock jumps, as far as it can see: it goes on with work that is no longer its own."""
    children = served.part("worker").children()
    for child in children:
        child.suspend()
    time.sleep(HELD_S)
    for child in children:
        child.resume()


def fill_the_disk(served: Served, chance: random.Random) -> None:
    filler = served.data_dir / "filler"
    try:
        with filler.open("wb") as file, contextlib.suppress(OSError):
            while True:
                file.write(bytes(2**20))
        time.sleep(HELD_S)
    finally:
        filler.unlink()


FAULTS = [
    kill_worker_child,
    kill_worker,
    kill_api,
    kill_reaper,
    kill_broker_with_its_data,
    lock_database,
    freeze_worker_beyond_its_lease,
    fill_the_disk,
]


def call(served: Served, method: str, path: str) -> httpx2.Response:
    """Ask until somebody answers: the API may just have been killed, or the database be locked."""
    deadline_s = time.monotonic() + 60
    while True:
        with contextlib.suppress(httpx2.TransportError):
            answer = served.client.request(method, path)
            if answer.status_code < 500:
                return answer
        assert time.monotonic() < deadline_s, f"{method} {path}"
        time.sleep(0.2)


def wait_for_end(served: Served, job_id: str) -> dict[str, Any]:
    deadline_s = time.monotonic() + END_S
    while (job := call(served, "GET", f"/v1/jobs/{job_id}").json())["state"] not in {"succeeded", "failed"}:
        assert time.monotonic() < deadline_s, f"stuck: {job}"
        time.sleep(0.2)
    return dict(job)


def one_run(
    served: Served, content: Sequence[Any], undisturbed: dict[Method, dict[str, str]], chance: random.Random
) -> tuple[str, str]:
    """Send a job, disturb it, and look at what came of it; returns the fault and the end."""
    method, fault = chance.choice(METHODS), chance.choice(FAULTS)
    moment_s = chance.uniform(0.0, LONGEST_WAIT_S)
    if fault is fill_the_disk and not served.data_dir.parent.is_mount():
        return fault.__name__, "skipped"
    wait_for(lambda: len(served.tree()) == NUM_PROCESSES, timeout_s=90)
    spec = ("spec", (None, f'{{"method": "{method}"}}'))
    answer = served.client.post("/v1/jobs", files=[*content, spec])
    assert answer.status_code == 202, answer.text
    time.sleep(moment_s)
    fault(served, chance)
    job = wait_for_end(served, answer.json()["id"])
    end = str(job["state"])
    if end == "failed":
        assert job["error"]["retryable"], job["error"]
        end = f"failed ({job['error']['code']}), succeeded when retried"
        assert call(served, "POST", f"/v1/jobs/{job['id']}/retry").status_code in {202, 409}
        job = wait_for_end(served, job["id"])
        assert job["state"] == "succeeded", job
    names = [one["name"] for one in call(served, "GET", f"/v1/jobs/{job['id']}/results").json()["results"]]
    assert sorted(names) == sorted(undisturbed[method])
    assert served.downloads(job["id"]) == undisturbed[method]
    assert call(served, "DELETE", f"/v1/sessions/{job['session_id']}").status_code == 204
    return fault.__name__, end


def test_soak(served: Served, capture: Path, undisturbed: dict[Method, dict[str, str]]) -> None:
    content = files(capture)
    ends: Counter[tuple[str, str]] = Counter()
    for number in range(RUNS):
        started_s = time.monotonic()
        found = one_run(served, content, undisturbed, random.Random(f"{SEED}/{number}"))  # noqa: S311 - no secret
        ends[found] += 1
        print(f"{number + 1}/{RUNS}: {found[0]}: {found[1]}, {time.monotonic() - started_s:.1f} s", flush=True)  # noqa: T201
    for (fault, end), count in sorted(ends.items()):
        print(f"{count:4d} x {fault}: {end}")  # noqa: T201
