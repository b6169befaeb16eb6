"""Outages at random moments of 20 jobs: none fails, none uses up a try, and all files are the same.

``pytest -m soak -s tests/faults/test_outages.py`` makes 100 rounds, or ``MULTICAP_OUTAGE_ROUNDS``, after the first
``MULTICAP_OUTAGE_FIRST``. The seed, ``MULTICAP_SOAK_SEED``, and a round's number decide its outages and their moments.
"""

import hashlib
import json
import os
import random
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from pipeline.capture.keypoints import open_keypoints
from pipeline.export.results import write_results
from pipeline.run.engine.local import reconstruct
from pipeline.validation.simulation.scenes import find_scene, record
from tests.e2e.serving import digests
from tests.e2e.test_serve_keypoints import files
from tests.faults.several_machines import SeveralMachines, several_machines
from tests.pipeline.simulations import write_simulation
from worker.store.spec import JobSpec

ROUNDS = int(os.environ.get("MULTICAP_OUTAGE_ROUNDS", "100"))
FIRST = int(os.environ.get("MULTICAP_OUTAGE_FIRST", "0"))
SEED = int(os.environ.get("MULTICAP_SOAK_SEED", "0"))
NUM_SESSIONS = 4
# Jobs of each session.
SPECS: tuple[dict[str, Any], ...] = (
    {},
    {"people": 1},
    {"exports": ["trc"]},
    {"frame_range": [5, 30]},
    {"smoothing": "butterworth"},
)
# Moments of outages after the beginning of a round.
LATEST_S = 12.0
SHORTEST_S, MEAN_MORE_S, LONGEST_S = 5.0, 6.0, 60.0
END_S = 600.0


@dataclass(frozen=True, slots=True)
class PlannedOutage:
    """Outage of a kind; it begins ``after_s`` and lasts ``seconds``."""

    kind: str
    after_s: float
    seconds: float


def bucket(mode: Any) -> Callable[[SeveralMachines, float], None]:
    def outage(service: SeveralMachines, seconds: float) -> None:
        service.proxy.set(mode)
        time.sleep(seconds)
        service.proxy.set("forward")

    return outage


def cut_database(service: SeveralMachines, seconds: float) -> None:
    with service.network.cut(service.postgres.port):
        time.sleep(seconds)


def forget_database(service: SeveralMachines, seconds: float) -> None:
    """Drop the open connections for ever."""
    service.network.forget(service.postgres.port)
    time.sleep(seconds)


def flush_broker(service: SeveralMachines, seconds: float) -> None:
    """Delete the messages, again and again."""
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        service.flush_broker()
        time.sleep(1.0)


# Outages of the same part do not overlap.
KINDS: Mapping[str, Mapping[str, Callable[[SeveralMachines, float], None]]] = {
    "bucket": {"unavailable": bucket("unavailable"), "hang": bucket("hang"), "reset": bucket("reset")},
    "database": {"cut": cut_database, "forgotten": forget_database},
    "broker": {"flushed": flush_broker},
}


def outages_of(chance: random.Random) -> list[PlannedOutage]:
    """One to three outages, of different parts."""
    chosen = chance.sample(sorted(KINDS), chance.randint(1, len(KINDS)))
    return [
        PlannedOutage(
            f"{part} {chance.choice(sorted(KINDS[part]))}",
            chance.uniform(0.0, LATEST_S),
            min(LONGEST_S, SHORTEST_S + chance.expovariate(1.0 / MEAN_MORE_S)),
        )
        for part in chosen
    ]


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Capture of two seconds."""
    folder = tmp_path_factory.mktemp("take")
    write_simulation(record(replace(find_scene("room"), duration_s=2.0), 3, 4), folder)
    return folder


@pytest.fixture(scope="module")
def expected(take: Path, tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, str]]:
    """SHA-256 of each result file of each spec, as the library writes them."""
    session = open_keypoints(take / "keypoints", take / "calibration.json", take / "timestamps.csv")
    found = []
    for spec in SPECS:
        folder = tmp_path_factory.mktemp("expected")
        config = JobSpec.model_validate(spec).config
        write_results(reconstruct(session, config), folder, config.exports)
        found.append(digests(folder))
    return found


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SeveralMachines]:
    with several_machines(tmp_path_factory.mktemp("machines")) as service:
        yield service


def disturb(service: SeveralMachines, outage: PlannedOutage) -> None:
    time.sleep(outage.after_s)
    part, _, kind = outage.kind.partition(" ")
    KINDS[part][kind](service, outage.seconds)


def one_session(service: SeveralMachines, take: Path, expected: list[dict[str, str]], name: str) -> int:
    """Send a session with a job of each spec, wait for their ends, and compare all files; return the jobs' failures."""
    sent = [*files(take), ("manifest", (None, json.dumps({"name": name}), "application/json"))]
    answer = service.call("POST", "/v1/sessions", files=sent, headers={"Idempotency-Key": name})
    assert answer.status_code == 201, answer.text
    session_id = answer.json()["id"]
    job_ids = []
    for number, spec in enumerate(SPECS):
        key = {"Idempotency-Key": f"{name}-{number}"}
        answer = service.call("POST", f"/v1/sessions/{session_id}/jobs", json=spec, headers=key)
        assert answer.status_code == 202, answer.text
        job_ids.append(answer.json()["id"])
    failures = 0
    for job_id, wanted in zip(job_ids, expected, strict=True):
        deadline_s = time.monotonic() + END_S
        while (job := service.call("GET", f"/v1/jobs/{job_id}").json())["state"] in {"queued", "running"}:
            assert time.monotonic() < deadline_s, f"stuck: {job}"
            time.sleep(0.5)
        assert job["state"] == "succeeded", job
        assert job["waiting_for"] is None
        attempts = service.call("GET", f"/v1/jobs/{job_id}/attempts").json()["attempts"]
        assert len(attempts) == 1
        failures += len(attempts[0]["failures"])
        results = service.call("GET", f"/v1/jobs/{job_id}/results").json()["results"]
        found = {file["name"]: hashlib.sha256(service.download(file["url"])).hexdigest() for file in results}
        assert found == wanted
    assert service.call("DELETE", f"/v1/sessions/{session_id}").status_code in {204, 404}
    return failures


def one_round(
    service: SeveralMachines,
    take: Path,
    expected: list[dict[str, str]],
    outages: list[PlannedOutage],
    name: str,
    num_sessions: int = NUM_SESSIONS,
) -> int:
    """Run the jobs of sessions under outages; return the number of tries that they used up."""
    with ThreadPoolExecutor(len(outages) + num_sessions) as threads:
        disturbing = [threads.submit(disturb, service, outage) for outage in outages]
        sessions = [
            threads.submit(one_session, service, take, expected, f"{name}-{number}") for number in range(num_sessions)
        ]
        failures = sum(session.result() for session in sessions)
        for future in disturbing:
            future.result()
    service.network.restore()
    return failures


@pytest.mark.slow
def test_outages_of_all_parts_at_once(service: SeveralMachines, take: Path, expected: list[dict[str, str]]) -> None:
    outages = [
        PlannedOutage("bucket unavailable", 2.0, 20.0),
        PlannedOutage("database forgotten", 1.0, 1.0),
        PlannedOutage("broker flushed", 0.0, 5.0),
    ]
    assert one_round(service, take, expected, outages, "at-once", num_sessions=2) == 0


@pytest.mark.slow
def test_page_answers_during_outage_and_job_says_reason(service: SeveralMachines, take: Path) -> None:
    seen: set[str] = set()
    session = service.call("POST", "/v1/sessions", files=files(take)).json()
    service.proxy.set("hang")
    job_id = service.call("POST", f"/v1/sessions/{session['id']}/jobs", json={}).json()["id"]
    stop = threading.Event()

    def ask() -> None:
        while not stop.is_set():
            seen.add(str(service.client.get("/readyz").status_code))

    asking = threading.Thread(target=ask)
    asking.start()
    deadline_s = time.monotonic() + END_S
    while (job := service.call("GET", f"/v1/jobs/{job_id}").json())["waiting_for"] is None:
        assert time.monotonic() < deadline_s
        time.sleep(0.2)
    assert job["waiting_for"]["code"] == "artifacts_unavailable"
    stop.set()
    asking.join()
    assert "503" in seen
    service.proxy.set("forward")
    while (job := service.call("GET", f"/v1/jobs/{job_id}").json())["state"] == "running":
        assert time.monotonic() < deadline_s
        time.sleep(0.2)
    assert (job["state"], job["waiting_for"]) == ("succeeded", None)


@pytest.mark.soak
def test_rounds(service: SeveralMachines, take: Path, expected: list[dict[str, str]]) -> None:
    print(f"seed {SEED}", flush=True)  # noqa: T201
    kinds: Counter[str] = Counter()
    failures = 0
    for number in range(FIRST, FIRST + ROUNDS):
        started_s = time.monotonic()
        outages = outages_of(random.Random(f"{SEED}/{number}"))  # noqa: S311 - no secret
        lost = one_round(service, take, expected, outages, f"{SEED}-{number}")
        failures += lost
        kinds.update(outage.kind for outage in outages)
        said = ", ".join(f"{outage.kind} {outage.seconds:.0f} s" for outage in outages)
        print(f"{number + 1}: {said}: 20 jobs in {time.monotonic() - started_s:.0f} s, {lost} tries", flush=True)  # noqa: T201
    for kind, count in sorted(kinds.items()):
        print(f"{count:4d} x {kind}")  # noqa: T201
    assert failures == 0
