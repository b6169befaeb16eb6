"""The reaper publishes for work that nobody took, and survives a database that is away."""

import time

import pytest

from tests.worker.conftest import Bench
from worker.jobs.artifacts import result_key
from worker.jobs.model import JobState
from worker.jobs.store import JobStore
from worker.reaper import expire, reap


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


def test_it_removes_results_whose_time_is_over(bench: Bench, capfd: pytest.CaptureFixture[str]) -> None:
    kept, short = bench.create_job(), bench.create_job(retention_s=0.05)
    bench.runner().work(60.0)
    time.sleep(0.1)
    expire(bench.store, bench.artifacts)
    assert bench.store.job(short.id).state is JobState.EXPIRED
    assert not bench.artifacts.exists(result_key(short.id, "person-1.bvh"))
    assert bench.store.job(kept.id).state is JobState.SUCCEEDED
    assert bench.artifacts.exists(result_key(kept.id, "person-1.bvh"))
    assert "job_expired" in "".join(capfd.readouterr())


def test_removing_begins_again_where_it_was_broken_off(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    job = bench.create_job(retention_s=0.05)
    bench.runner().work(60.0)
    time.sleep(0.1)
    with monkeypatch.context() as broken:
        broken.setattr(bench.store, "expire", lambda job_id: 1 / 0)
        expire(bench.store, bench.artifacts)
    assert bench.store.job(job.id).state is JobState.SUCCEEDED
    assert not bench.artifacts.exists(result_key(job.id, "person-1.bvh"))
    expire(bench.store, bench.artifacts)
    assert bench.store.job(job.id).state is JobState.EXPIRED
