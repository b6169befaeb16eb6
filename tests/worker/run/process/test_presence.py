"""Row of a worker process in the list of workers."""

import time
from collections.abc import Collection
from dataclasses import replace

import pytest
from sqlalchemy.exc import OperationalError

from tests.waiting import wait_for
from tests.worker.conftest import RunnerBench
from worker.run.process.presence import Presence, process_name, remove_killed
from worker.store.worker_status import WorkerState, WorkerStatus

STARTING = WorkerStatus(process_name(), WorkerState.STARTING, "A worker loads its libraries")


def test_a_change_is_told_at_once_and_the_end_too(bench: RunnerBench) -> None:
    now: list[WorkerStatus | None] = [STARTING]
    presence = Presence(bench.store.workers, lambda: now[0])
    presence.start()
    wait_for(lambda: bench.store.workers.all() == [STARTING])
    ready = replace(STARTING, state=WorkerState.READY, detectors=("movenet-multipose",))
    now[0] = ready
    changed_s = time.monotonic()
    wait_for(lambda: bench.store.workers.all() == [ready])
    assert time.monotonic() - changed_s < 1.5
    # A worker that shuts down leaves the list long before its process ends.
    now[0] = None
    wait_for(lambda: bench.store.workers.all() == [])
    presence.stop()


def test_stopping_takes_the_process_off_the_list(bench: RunnerBench) -> None:
    presence = Presence(bench.store.workers, lambda: STARTING)
    presence.start()
    wait_for(lambda: bench.store.workers.all() == [STARTING])
    presence.stop()
    assert bench.store.workers.all() == []


@pytest.mark.slow
def test_a_database_that_is_away_is_told_as_soon_as_it_is_back(bench: RunnerBench) -> None:
    class UnreachableWorkers:
        tries = 0

        def report(self, status: WorkerStatus) -> None:
            self.tries += 1
            if self.tries == 1:
                raise OperationalError("", {}, Exception("away"))
            bench.store.workers.report(status)

        def remove(self, worker_ids: Collection[str]) -> None:
            bench.store.workers.remove(worker_ids)

    workers = UnreachableWorkers()
    presence = Presence(workers, lambda: STARTING)  # type: ignore[arg-type]
    presence.start()
    wait_for(lambda: bench.store.workers.all() == [STARTING])
    assert workers.tries == 2
    presence.stop()


def test_killed_processes_of_this_machine_are_taken_off_the_list(bench: RunnerBench) -> None:
    host = process_name().rpartition(":")[0]
    killed = replace(STARTING, id=f"{host}:4194304")  # beyond the largest process id
    elsewhere = replace(STARTING, id="another-machine:4194304")
    for status in (STARTING, killed, elsewhere):
        bench.store.workers.report(status)
    remove_killed(bench.store.workers)
    assert {worker.id for worker in bench.store.workers.all()} == {STARTING.id, elsewhere.id}
