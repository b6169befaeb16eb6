"""Faults at random moments of real jobs on a real service: every job ends with the right bytes.

The suite causes once each fault that no other test causes; ``make soak`` makes 200 runs, or ``MULTICAP_SOAK_RUNS``.
The seed, ``MULTICAP_SOAK_SEED``, and a run's number decide its fault and its moment; every fault has its turn.
"""

import os
import random
import subprocess
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from pipeline.core.options.config import Method
from tests.e2e.serving import NUM_PROCESSES
from tests.e2e.test_serve_keypoints import files
from tests.faults.conftest import METHODS
from tests.faults.faults import (
    AT_ONCE,
    FAULTS,
    Fault,
    back_up_and_restore_elsewhere,
    call,
    freeze_worker_beyond_its_lease,
    is_possible,
    kill_api,
    kill_broker_with_its_data,
    kill_worker,
    kill_worker_child,
    lose_the_message,
    set_clock,
    set_the_clock,
    wait_for_end,
)
from tests.faults.service import CLOCK, SmallDiskService, receiving
from tests.waiting import wait_for

RUNS = int(os.environ.get("MULTICAP_SOAK_RUNS", "200"))
SEED = int(os.environ.get("MULTICAP_SOAK_SEED", "0"))
# Services among which the suite's faults are shared out: they mostly wait.
SERVICES = 2
# Faults that other tests cause, in a job of videos or of small stages: only the soak causes them here, too.
ELSEWHERE = {
    kill_worker_child,
    kill_worker,
    kill_api,
    kill_broker_with_its_data,
    lose_the_message,
    freeze_worker_beyond_its_lease,
}
# About the duration of a job: some faults come before its start, some after its end.
LONGEST_WAIT_S = 5.0
# Time in which a lost message is replaced.
NOTICED_S = 30.0
# Time in which a webhook whose sender was killed is sent again.
TOLD_S = 120.0


@pytest.fixture(scope="module")
def disk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Small disk for the service's data, if this machine allows mounting one."""
    folder = tmp_path_factory.mktemp("soak") / "disk"
    folder.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=512m", "tmpfs", folder], check=False).returncode == 0
    yield folder
    if mounted:
        subprocess.run(["umount", "--lazy", folder], check=True)


@pytest.fixture(scope="module")
def service(disk: Path) -> Iterator[SmallDiskService]:
    set_clock(disk, 0.0)
    with receiving() as receiver:
        service = SmallDiskService(disk, receiver)
        service.start()
        try:
            service.make_webhook_secret()
            yield service
        finally:
            service.stop()


def one_run(
    service: SmallDiskService,
    content: Sequence[Any],
    undisturbed: dict[Method, dict[str, str]],
    fault: Fault,
    chance: random.Random,
) -> str:
    """Send a job, cause a fault, and check the result; return the job's final state."""
    method = chance.choice(METHODS)
    moment_s = 0.0 if fault in AT_ONCE else chance.uniform(0.0, LONGEST_WAIT_S)
    wait_for(lambda: len(service.served.tree()) == NUM_PROCESSES, timeout_s=90)
    spec = ("spec", (None, f'{{"method": "{method}", "callback_url": "{service.receiver.url}"}}'))
    answer = service.served.client.post("/v1/jobs", files=[*content, spec])
    assert answer.status_code == 202, answer.text
    job_id, session_id = answer.json()["id"], answer.json()["session_id"]
    clock_s = time.time() + float((service.disk / CLOCK).read_text())
    assert abs(datetime.fromisoformat(answer.json()["created_at"]).timestamp() - clock_s) < 60
    time.sleep(moment_s)
    fault(service, chance, job_id)
    if fault is lose_the_message:
        wait_for(lambda: call(service, "GET", f"/v1/jobs/{job_id}").json()["state"] != "queued", timeout_s=NOTICED_S)
    job = wait_for_end(service, job_id)
    end, told = str(job["state"]), {f"job.{job['state']}"}
    if end == "failed":
        assert job["error"]["retryable"], job["error"]
        end = f"failed ({job['error']['code']}), succeeded when retried"
        assert call(service, "POST", f"/v1/jobs/{job_id}/retry").status_code in {202, 409}
        job = wait_for_end(service, job_id)
        assert job["state"] == "succeeded", job
        told.add("job.succeeded")
    names = [one["name"] for one in call(service, "GET", f"/v1/jobs/{job_id}/results").json()["results"]]
    assert sorted(names) == sorted(undisturbed[method])
    assert service.served.downloads(job_id) == undisturbed[method]
    if fault is back_up_and_restore_elsewhere:
        assert service.restored == undisturbed[method]
    assert [one["id"] for one in call(service, "GET", "/v1/jobs").json()["jobs"]] == [job_id]
    assert [one["id"] for one in call(service, "GET", "/v1/sessions").json()["sessions"]] == [session_id]
    if fault is not set_the_clock:  # after a change of the clock a message may be due an hour later
        wait_for(lambda: {kind for one, kind in service.receiver.messages if one == job_id} == told, timeout_s=TOLD_S)
        assert all(len(service.receiver.messages[job_id, kind]) == 1 for kind in told)
    assert call(service, "DELETE", f"/v1/sessions/{session_id}").status_code == 204
    assert [path for path in (service.data_dir / "artifacts").glob("*/*") if path.parent.name != ".incoming"] == []
    service.filler.unlink(missing_ok=True)
    return end


@pytest.mark.parametrize(
    "fault",
    [
        pytest.param(fault, id=fault.__name__, marks=pytest.mark.xdist_group(f"faults {number % SERVICES}"))
        for number, fault in enumerate(fault for fault in FAULTS if fault not in ELSEWHERE)
    ],
)
def test_each_fault(
    service: SmallDiskService, capture: Path, undisturbed: dict[Method, dict[str, str]], fault: Fault
) -> None:
    if not is_possible(fault, service):
        pytest.skip("this machine mounts no small disk")
    chance = random.Random(f"{SEED}/{fault.__name__}")  # noqa: S311 - no secret
    one_run(service, files(capture), undisturbed, fault, chance)
    assert service.receiver.forged == []


@pytest.mark.soak
def test_soak(service: SmallDiskService, capture: Path, undisturbed: dict[Method, dict[str, str]]) -> None:
    content = files(capture)
    print(f"seed {SEED}", flush=True)  # noqa: T201
    ends: Counter[tuple[str, str]] = Counter()
    faults = [fault for fault in FAULTS if is_possible(fault, service)]
    for number in range(RUNS):
        started_s = time.monotonic()
        turn, place = divmod(number, len(faults))
        fault = random.Random(f"{SEED}/{turn}").sample(faults, len(faults))[place]  # noqa: S311 - no secret
        end = one_run(service, content, undisturbed, fault, random.Random(f"{SEED}/{number}"))  # noqa: S311
        ends[fault.__name__, end] += 1
        print(f"{number + 1}/{RUNS}: {fault.__name__}: {end}, {time.monotonic() - started_s:.1f} s", flush=True)  # noqa: T201
    for (name, end), count in sorted(ends.items()):
        print(f"{count:4d} x {name}: {end}")  # noqa: T201
    assert service.receiver.forged == []
