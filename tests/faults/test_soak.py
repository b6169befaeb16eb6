"""Faults at random moments of real jobs on a real service: every job ends as it should, byte by byte.

A few runs are part of the suite; ``make soak`` makes 200, or ``MULTICAP_SOAK_RUNS``. The seed, ``MULTICAP_SOAK_SEED``,
and a run's number decide its fault and its moment; every fault has its turn.
"""

import contextlib
import os
import random
import shutil
import sqlite3
import subprocess
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import httpx2
import psutil
import pytest
import valkey

from api.commands.reconstruct import write_results
from pipeline.config import Method, ReconstructionConfig
from pipeline.keypoints import open_keypoints
from pipeline.run import reconstruct_keypoints
from pipeline.simulation.files import simulation_files
from pipeline.simulation.scenes import find_scene, record
from tests.e2e.serving import NUM_PROCESSES, Served, digests, serving, wait_for
from tests.e2e.test_serve_keypoints import files

pytestmark = pytest.mark.xdist_group("faults")

FEW_RUNS = 12
RUNS = int(os.environ.get("MULTICAP_SOAK_RUNS", "200"))
SEED = int(os.environ.get("MULTICAP_SOAK_SEED", "0"))
METHODS: tuple[Method, ...] = ("tracking", "clustering")
# A job takes about so long: some faults come before it has begun, some after its end.
LONGEST_WAIT_S = 5.0
# Longer than a lease.
HELD_S = 5.0
END_S = 120.0
# A message that was lost is noticed by then.
NOTICED_S = 30.0
# How far the service's clock is from ours, in seconds; see ``clock/sitecustomize.py``.
CLOCK = "clock"
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
    set_clock(disk, 0.0)
    clock = {"PYTHONPATH": str(Path(__file__).parent / "clock"), "MULTICAP_TEST_CLOCK": str(disk / CLOCK)}
    with serving(disk / "data", **ENVIRONMENT, **clock) as served:
        yield served


def set_clock(folder: Path, offset_s: float) -> None:
    """Have the service's clock, but for its monotonic one, show another time than ours."""
    new = folder / f"{CLOCK}.new"
    new.write_text(f"{offset_s:.3f}")
    new.replace(folder / CLOCK)


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


def lose_the_message(served: Served, chance: random.Random) -> None:
    """Whoever has it dies, and the broker forgets it."""
    kill(served.part("worker"))
    with valkey.Valkey(unix_socket_path=str(served.data_dir / "broker" / "socket")) as broker:
        broker.flushall()


def set_the_clock(served: Served, chance: random.Random) -> None:
    set_clock(served.data_dir.parent, chance.uniform(-7200.0, 7200.0))


def freeze_worker_beyond_its_lease(served: Served, chance: random.Random) -> None:
    """It goes on with work that is no longer its own."""
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


Fault = Callable[[Served, random.Random], None]
FAULTS: list[Fault] = [
    kill_worker_child,
    kill_worker,
    kill_api,
    kill_reaper,
    kill_broker_with_its_data,
    lock_database,
    freeze_worker_beyond_its_lease,
    fill_the_disk,
    lose_the_message,
    set_the_clock,
]
# These come as soon as the job was accepted, the others at any moment.
AT_ONCE = {lose_the_message}


def is_possible(fault: Fault, served: Served) -> bool:
    """Whether this machine lets us."""
    return fault is not fill_the_disk or served.data_dir.parent.is_mount()


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
    served: Served,
    content: Sequence[Any],
    undisturbed: dict[Method, dict[str, str]],
    fault: Fault,
    chance: random.Random,
) -> str:
    """Send a job, disturb it, and look at what came of it; returns how it ended."""
    method = chance.choice(METHODS)
    moment_s = 0.0 if fault in AT_ONCE else chance.uniform(0.0, LONGEST_WAIT_S)
    wait_for(lambda: len(served.tree()) == NUM_PROCESSES, timeout_s=90)
    spec = ("spec", (None, f'{{"method": "{method}"}}'))
    answer = served.client.post("/v1/jobs", files=[*content, spec])
    assert answer.status_code == 202, answer.text
    job_id, session_id = answer.json()["id"], answer.json()["session_id"]
    clock_s = time.time() + float((served.data_dir.parent / CLOCK).read_text())
    assert abs(datetime.fromisoformat(answer.json()["created_at"]).timestamp() - clock_s) < 60
    time.sleep(moment_s)
    fault(served, chance)
    if fault is lose_the_message:
        wait_for(lambda: call(served, "GET", f"/v1/jobs/{job_id}").json()["state"] != "queued", timeout_s=NOTICED_S)
    job = wait_for_end(served, job_id)
    end = str(job["state"])
    if end == "failed":
        assert job["error"]["retryable"], job["error"]
        end = f"failed ({job['error']['code']}), succeeded when retried"
        assert call(served, "POST", f"/v1/jobs/{job_id}/retry").status_code in {202, 409}
        job = wait_for_end(served, job_id)
        assert job["state"] == "succeeded", job
    names = [one["name"] for one in call(served, "GET", f"/v1/jobs/{job_id}/results").json()["results"]]
    assert sorted(names) == sorted(undisturbed[method])
    assert served.downloads(job_id) == undisturbed[method]
    assert [one["id"] for one in call(served, "GET", "/v1/jobs").json()["jobs"]] == [job_id]
    assert [one["id"] for one in call(served, "GET", "/v1/sessions").json()["sessions"]] == [session_id]
    assert call(served, "DELETE", f"/v1/sessions/{session_id}").status_code == 204
    assert [path for path in (served.data_dir / "artifacts").glob("*/*") if path.parent.name != ".incoming"] == []
    return end


def disturb(served: Served, capture: Path, undisturbed: dict[Method, dict[str, str]], runs: int) -> None:
    """Make so many runs, and say what came of them."""
    content = files(capture)
    print(f"seed {SEED}", flush=True)  # noqa: T201
    ends: Counter[tuple[str, str]] = Counter()
    faults = [fault for fault in FAULTS if is_possible(fault, served)]
    for number in range(runs):
        started_s = time.monotonic()
        turn, place = divmod(number, len(faults))
        fault = random.Random(f"{SEED}/{turn}").sample(faults, len(faults))[place]  # noqa: S311 - no secret
        end = one_run(served, content, undisturbed, fault, random.Random(f"{SEED}/{number}"))  # noqa: S311
        ends[fault.__name__, end] += 1
        print(f"{number + 1}/{runs}: {fault.__name__}: {end}, {time.monotonic() - started_s:.1f} s", flush=True)  # noqa: T201
    for (name, end), count in sorted(ends.items()):
        print(f"{count:4d} x {name}: {end}")  # noqa: T201


def test_a_few_faults(served: Served, capture: Path, undisturbed: dict[Method, dict[str, str]]) -> None:
    disturb(served, capture, undisturbed, FEW_RUNS)


@pytest.mark.soak
def test_soak(served: Served, capture: Path, undisturbed: dict[Method, dict[str, str]]) -> None:
    disturb(served, capture, undisturbed, RUNS)
