"""Faults at random moments of jobs on a cluster of processes: no job is lost, doubled or failed, bytes are the same.

The suite causes most faults once; ``pytest -m soak -s tests/faults/test_cluster.py`` makes 200 runs, or
``MULTICAP_SOAK_RUNS``. The seed, ``MULTICAP_SOAK_SEED``, and a run's number decide its fault and its moment.
"""

import contextlib
import hashlib
import json
import os
import random
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import psutil
import pytest

from pipeline.capture.keypoints import open_keypoints
from pipeline.export.results import write_results
from pipeline.run.engine.local import reconstruct
from pipeline.validation.simulation.scenes import find_scene, record
from tests.e2e.serving import digests
from tests.e2e.test_serve_keypoints import files
from tests.faults.cluster import Cluster, running_cluster
from tests.faults.service import ROOT, other_version
from tests.pipeline.simulations import write_simulation

RUNS = int(os.environ.get("MULTICAP_SOAK_RUNS", "200"))
SEED = int(os.environ.get("MULTICAP_SOAK_SEED", "0"))
# About the duration of a job: some faults come before its first chunk, some after its end.
LONGEST_WAIT_S = 4.0
# Beyond a lease of 3 s.
HELD_S = 4.5
MOST_CLOCK_S = 300.0
END_S = 300.0
PARTS = ("api", "worker", "reaper")

Fault = Callable[[Cluster, random.Random], None]


def kill(cluster: Cluster, chance: random.Random) -> None:
    """Kill a process of a program; its children end with it."""
    part = chance.choice(PARTS)
    processes = cluster.programs[f"{part}-{chance.randrange(2)}"].tree()
    if processes:
        with contextlib.suppress(psutil.NoSuchProcess):
            chance.choice(processes).kill()


def pause(cluster: Cluster, chance: random.Random) -> None:
    """Suspend a program, for less or for more than a lease."""
    tree = cluster.programs[f"{chance.choice(PARTS)}-{chance.randrange(2)}"].tree()
    for process in tree:
        with contextlib.suppress(psutil.NoSuchProcess):
            process.suspend()
    time.sleep(chance.uniform(0.5, HELD_S))
    for process in tree:
        with contextlib.suppress(psutil.NoSuchProcess):
            process.resume()


def lose_broker(cluster: Cluster, chance: random.Random) -> None:
    """Kill the broker, with its messages."""
    for process in cluster.programs["broker"].tree():
        process.kill()
    time.sleep(chance.uniform(0.0, 2.0))


def cut_bucket(cluster: Cluster, chance: random.Random) -> None:
    """Cut the connections to the bucket, and let none be made for a while."""
    cluster.bucket.set(chance.choice(["reset", "hang", "refuse"]))
    time.sleep(chance.uniform(0.5, HELD_S))
    cluster.bucket.set("forward")


def fail_bucket(cluster: Cluster, chance: random.Random) -> None:
    """Let the bucket answer with errors for a while."""
    cluster.bucket.set(chance.choice(["unavailable", "slow_down"]))
    time.sleep(chance.uniform(0.5, HELD_S))
    cluster.bucket.set("forward")


def restart_database(cluster: Cluster, chance: random.Random) -> None:
    """Restart PostgreSQL: in order, or as after a crash."""
    cluster.postgres.control("-m", chance.choice(["fast", "immediate"]), "stop")
    time.sleep(chance.uniform(0.0, 2.0))
    cluster.postgres.control("start")


def set_a_clock(cluster: Cluster, chance: random.Random) -> None:
    """Put the clock of some programs before or back by up to five minutes."""
    for name, program in cluster.programs.items():
        if name != "broker" and chance.random() < 0.5:
            program.set_clock(chance.uniform(-MOST_CLOCK_S, MOST_CLOCK_S))


def upgrade(cluster: Cluster, chance: random.Random) -> None:
    """Replace one program after another by another version, or by ours again."""
    names = [name for name in cluster.programs if name != "broker"]
    code = ROOT
    if cluster.programs[names[0]].code == ROOT:
        code = other_version(cluster.programs["broker"].folder / "other_version")
    for name in names:
        program = cluster.programs[name]
        program.stop()
        program.code = code
        program.start()


FAULTS: list[Fault] = [
    kill,
    pause,
    lose_broker,
    cut_bucket,
    fail_bucket,
    restart_database,
    set_a_clock,
    upgrade,
]
# Chances of the faults: an upgrade takes half a minute.
WEIGHTS = [6, 5, 2, 3, 3, 2, 2, 1]


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Capture of two seconds."""
    folder = tmp_path_factory.mktemp("take")
    write_simulation(record(replace(find_scene("room"), duration_s=2.0), 3, 4), folder)
    return folder


@pytest.fixture(scope="module")
def expected(take: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """SHA-256 of each result file that the library writes."""
    folder = tmp_path_factory.mktemp("expected")
    session = open_keypoints(take / "keypoints", take / "calibration.json", take / "timestamps.csv")
    write_results(reconstruct(session), folder)
    return digests(folder)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    with running_cluster(tmp_path_factory.mktemp("cluster")) as cluster:
        yield cluster


def one_run(
    cluster: Cluster, take: Path, expected: dict[str, str], fault: Fault, chance: random.Random, name: str
) -> None:
    """Send a job, cause a fault at a random moment, and check the job, its files, and that there is no other."""
    moment_s = chance.uniform(0.0, LONGEST_WAIT_S)
    manifest = ("manifest", (None, json.dumps({"name": name}), "application/json"))
    answer = cluster.call("POST", "/v1/jobs", files=[*files(take), manifest], headers={"Idempotency-Key": name})
    assert answer.status_code == 202, answer.text
    job_id, session_id = answer.json()["id"], answer.json()["session_id"]
    time.sleep(moment_s)
    fault(cluster, chance)
    cluster.repair()
    deadline_s = time.monotonic() + END_S
    while (job := cluster.call("GET", f"/v1/jobs/{job_id}").json())["state"] in {"queued", "running"}:
        assert time.monotonic() < deadline_s, f"stuck: {job}"
        time.sleep(0.2)
    assert job["state"] == "succeeded", job
    results = cluster.call("GET", f"/v1/jobs/{job_id}/results").json()["results"]
    found = {file["name"]: hashlib.sha256(cluster.download(file["url"])).hexdigest() for file in results}
    assert found == expected
    assert [listed["id"] for listed in cluster.call("GET", "/v1/jobs").json()["jobs"]] == [job_id]
    assert [listed["id"] for listed in cluster.call("GET", "/v1/sessions").json()["sessions"]] == [session_id]
    assert cluster.call("DELETE", f"/v1/sessions/{session_id}").status_code in {204, 404}
    for program in cluster.programs.values():
        program.set_clock(0.0)


# Errors of the bucket and other clocks have tests of their own, see `test_outages.py` and `test_soak.py`.
ONCE = [fault for fault in FAULTS if fault not in {fail_bucket, set_a_clock}]


@pytest.mark.parametrize("fault", ONCE, ids=[fault.__name__ for fault in ONCE])
def test_each_fault_of_cluster(cluster: Cluster, take: Path, expected: dict[str, str], fault: Fault) -> None:
    chance = random.Random(f"{SEED}/{fault.__name__}")  # noqa: S311 - no secret
    one_run(cluster, take, expected, fault, chance, fault.__name__)


@pytest.mark.soak
def test_soak_of_cluster(cluster: Cluster, take: Path, expected: dict[str, str]) -> None:
    print(f"seed {SEED}", flush=True)  # noqa: T201
    kinds: Counter[str] = Counter()
    for number in range(RUNS):
        started_s = time.monotonic()
        chance = random.Random(f"{SEED}/{number}")  # noqa: S311 - no secret
        (fault,) = chance.choices(FAULTS, WEIGHTS)
        one_run(cluster, take, expected, fault, chance, f"{SEED}-{number}")
        kinds[fault.__name__] += 1
        print(f"{number + 1}/{RUNS}: {fault.__name__}: {time.monotonic() - started_s:.1f} s", flush=True)  # noqa: T201
    for kind, count in sorted(kinds.items()):
        print(f"{count:4d} x {kind}")  # noqa: T201
