"""The reaper publishes for work that nobody took, and survives a database that is away."""

import time

import pytest

from tests.worker.conftest import Bench
from worker.jobs.model import JobState
from worker.jobs.store import JobStore
from worker.reaper import reap


class Publisher:
    """Counts what is published."""

    def __init__(self) -> None:
        self.count = 0

    def __call__(self) -> None:
        self.count += 1


def test_it_publishes_for_ready_work_only(bench: Bench) -> None:
    publish = Publisher()
    reap(bench.store, publish)
    assert publish.count == 0
    bench.create_job()
    reap(bench.store, publish)
    assert publish.count == 1
    bench.runner().work(60.0)
    reap(bench.store, publish)
    assert publish.count == 1


def test_it_frees_what_a_silent_worker_held(bench: Bench) -> None:
    job = bench.create_job()
    claims = [bench.store.claim("gone", 0.05) for _ in range(4)]
    assert all(claims)
    publish = Publisher()
    time.sleep(0.1)
    reap(bench.store, publish)
    assert publish.count == 1
    bench.runner().work(60.0)
    assert bench.store.job(job.id).state is JobState.SUCCEEDED


def test_it_survives_a_database_that_is_away(capfd: pytest.CaptureFixture[str]) -> None:
    store = JobStore("sqlite:////nonexistent/folder/multicap.db")
    reap(store, Publisher())
    store.close()
    assert "reap_failed" in "".join(capfd.readouterr())
