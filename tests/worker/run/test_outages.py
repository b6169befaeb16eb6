"""Outages of the artifact store, the database and the broker: no job fails, no try is used up, the job says why."""

import sqlite3
import threading
from collections.abc import Iterator
from typing import Any

import obstore
import pytest
from sqlalchemy.exc import OperationalError

from pipeline.run.engine.stage import ASSOCIATE, DETECT, Output
from tests.s3 import S3, running_s3
from tests.unreliable import Mode, UnreliableProxy, unreliable
from tests.waiting import wait_for
from tests.worker.conftest import RESULT, RunnerBench, detect
from worker.run.chunk import Work
from worker.run.problems import waiting_for
from worker.run.reaper import Reaper
from worker.store.files.artifacts import open_artifacts
from worker.store.files.disk import DiskSpace
from worker.store.files.file_keys import stage_key
from worker.store.model.job_records import JobRecord
from worker.store.model.states import FINISHED, ChunkState, JobState
from worker.store.outages import Outage
from worker.store.repositories.work.leases import MAX_ATTEMPTS
from worker.store.store import JobStore


@pytest.fixture(scope="module")
def s3() -> Iterator[S3]:
    with running_s3() as server:
        yield server


@pytest.fixture
def proxy(s3: S3) -> Iterator[UnreliableProxy]:
    with unreliable(int(s3.endpoint.rpartition(":")[2])) as proxy:
        yield proxy


@pytest.fixture
def on_s3(bench: RunnerBench, s3: S3, proxy: UnreliableProxy, monkeypatch: pytest.MonkeyPatch) -> RunnerBench:
    """Bench whose artifacts are behind the proxy."""
    for name, value in (s3.environment | {"AWS_ENDPOINT_URL": proxy.endpoint}).items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr("worker.store.files.s3._READ_TIMEOUT", "1s")
    monkeypatch.setattr("worker.run.runner._LONGEST_PAUSE_S", 1.0)
    bench.artifacts = open_artifacts(s3.new_url(), bench.data_dir)  # type: ignore[assignment]
    return bench


def begin_work(bench: RunnerBench) -> threading.Thread:
    thread = threading.Thread(target=bench.runner().work, args=[600.0], daemon=True)
    thread.start()
    return thread


def tries_of(bench: RunnerBench, job: JobRecord) -> int:
    return sum(len(attempt.failures) for attempt in bench.store.jobs.attempts(job.id))


@pytest.mark.parametrize("mode", ["unavailable", "slow_down", "hang", "reset", "refuse"])
def test_silent_store_makes_job_wait_and_costs_no_try(on_s3: RunnerBench, proxy: UnreliableProxy, mode: Mode) -> None:
    job = on_s3.create_job()
    began = threading.Event()

    def detect_and_lose_the_store(work: Work) -> Output:
        if not began.is_set():
            proxy.set(mode)
            began.set()
        return detect(work)

    on_s3.stages[DETECT] = detect_and_lose_the_store
    thread = begin_work(on_s3)
    wait_for(lambda: on_s3.store.jobs.get(job.id).waiting_for is not None, timeout_s=120)
    waiting = on_s3.store.jobs.get(job.id)
    assert waiting.state is JobState.RUNNING
    assert waiting.waiting_for is not None
    assert (waiting.waiting_for.code, waiting.waiting_for.stage) == ("artifacts_unavailable", DETECT)
    proxy.set("forward")
    thread.join(120)
    ended = on_s3.store.jobs.get(job.id)
    assert (ended.state, ended.waiting_for) == (JobState.SUCCEEDED, None)
    assert on_s3.result(job.id) == RESULT
    assert tries_of(on_s3, job) == 0
    assert on_s3.store.figures().totals["chunks_given_back", DETECT] >= 1
    assert ("chunks_retried", DETECT) not in on_s3.store.figures().totals


def test_waiting_job_can_be_canceled(on_s3: RunnerBench, proxy: UnreliableProxy) -> None:
    job = on_s3.create_job()
    proxy.set("unavailable")
    thread = begin_work(on_s3)
    wait_for(lambda: on_s3.store.jobs.get(job.id).waiting_for is not None, timeout_s=120)
    on_s3.store.jobs.cancel(job.id)
    wait_for(lambda: on_s3.store.jobs.get(job.id).state is JobState.CANCELED, timeout_s=180)
    assert on_s3.store.jobs.get(job.id).waiting_for is None
    on_s3.stopping = True
    thread.join(60)
    assert not thread.is_alive()


def test_store_that_refuses_is_no_outage(on_s3: RunnerBench, proxy: UnreliableProxy) -> None:
    job = on_s3.create_job()
    proxy.set("forbidden")
    on_s3.runner().work(600.0)
    failed = on_s3.store.jobs.get(job.id)
    assert failed.state is JobState.FAILED
    assert failed.problem is not None
    assert (failed.problem.code, failed.problem.retryable) == ("artifacts_refused", True)
    assert tries_of(on_s3, job) == MAX_ATTEMPTS


def test_missing_bucket_is_no_outage_and_no_damaged_output(on_s3: RunnerBench) -> None:
    job = on_s3.create_job()
    on_s3.artifacts = open_artifacts("s3://no-such-bucket/prefix", on_s3.data_dir)  # type: ignore[assignment]
    on_s3.runner().work(600.0)
    failed = on_s3.store.jobs.get(job.id)
    assert failed.problem is not None
    assert (failed.state, failed.problem.code) == (JobState.FAILED, "artifacts_refused")


def test_missing_object_is_computed_again(on_s3: RunnerBench) -> None:
    def lose_an_output(work: Work) -> Output:
        (output, *_) = on_s3.store.outputs.list_stage(work.claim.job_id, DETECT)
        if not lost:
            lost.append(output.key)
            obstore.delete(on_s3.artifacts._store, stage_key(work.claim.session_id, output.key))  # type: ignore[attr-defined]
        return Output(b",".join(work.outputs(DETECT)))

    lost: list[str] = []
    job = on_s3.create_job()
    on_s3.stages[ASSOCIATE] = lose_an_output
    on_s3.runner().work(600.0)
    assert lost
    assert on_s3.store.jobs.get(job.id).state is JobState.SUCCEEDED
    assert on_s3.result(job.id) == RESULT


class CutOff:
    """Store whose database does not respond for a while, to one worker or to everybody."""

    def __init__(self, store: JobStore, monkeypatch: pytest.MonkeyPatch) -> None:
        self.away = False
        database = store._database
        for name in ("reading", "writing"):
            monkeypatch.setattr(database, name, self._guarded(getattr(database, name)))

    def _guarded(self, transaction: Any) -> Any:
        def begin() -> Any:
            if self.away:
                error = sqlite3.OperationalError("disk I/O error")
                error.sqlite_errorcode = sqlite3.SQLITE_IOERR
                raise OperationalError("BEGIN", {}, error)
            return transaction()

        return begin


def test_database_outage_does_not_stop_work(bench: RunnerBench, monkeypatch: pytest.MonkeyPatch) -> None:
    others = JobStore(f"sqlite:///{bench.data_dir / 'multicap.db'}")
    outage = CutOff(bench.store, monkeypatch)
    runs: list[int] = []

    def detect_in_an_outage(work: Work) -> Output:
        runs.append(work.claim.index)
        if len(runs) == 1:
            outage.away = True
            threading.Timer(2.0, setattr, [outage, "away", False]).start()
            threading.Event().wait(1.0)  # longer than the lease
        return detect(work)

    bench.stages[DETECT] = detect_in_an_outage
    job = bench.create_job()
    bench.runner(lease_s=0.5, heartbeat_s=0.1).work(600.0)
    assert others.jobs.get(job.id).state is JobState.SUCCEEDED
    assert len(runs) == 4  # none twice
    assert bench.result(job.id) == RESULT
    assert tries_of(bench, job) == 0
    others.close()


def test_worker_that_was_cut_off_but_not_lost_uses_up_no_try(
    bench: RunnerBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    others = JobStore(f"sqlite:///{bench.data_dir / 'multicap.db'}")
    outage = CutOff(bench.store, monkeypatch)
    job = bench.create_job()
    lost: list[int] = []

    def detect_cut_off(work: Work) -> Output:
        if not lost:
            lost.append(work.claim.chunk_id)
            outage.away = True
            threading.Event().wait(1.0)
            others.leases.reap(0.5)  # by a reaper that is not cut off
            assert len(others.jobs.attempts(job.id)[0].failures) == 1
            outage.away = False
        return detect(work)

    bench.stages[DETECT] = detect_cut_off
    bench.runner(lease_s=0.5, heartbeat_s=0.1).work(600.0)
    assert others.jobs.get(job.id).state is JobState.SUCCEEDED
    assert bench.result(job.id) == RESULT
    assert tries_of(bench, job) == 0
    others.close()


def test_reaper_after_outage_lets_workers_renew_leases(bench: RunnerBench, monkeypatch: pytest.MonkeyPatch) -> None:
    outage = CutOff(bench.store, monkeypatch)
    job = bench.create_job()
    assert bench.store.leases.claim("cut-off", 0.05) is not None
    reaper = Reaper(bench.store, bench.artifacts, DiskSpace(bench.data_dir), lambda: True, lease_s=1.5)
    outage.away = True
    reaper.reap()
    outage.away = False
    reaper.reap()
    assert tries_of(bench, job) == 0
    wait_for(lambda: reaper.reap() or tries_of(bench, job) == 1, timeout_s=120)  # type: ignore[func-returns-value]


def test_job_waits_for_broker_until_it_responds(bench: RunnerBench) -> None:
    job = bench.create_job()
    responds = False
    reaper = Reaper(bench.store, bench.artifacts, DiskSpace(bench.data_dir), lambda: responds, lease_s=20.0)
    reaper.reap()
    waiting = bench.store.jobs.get(job.id)
    assert waiting.waiting_for is not None
    assert (waiting.state, waiting.waiting_for.code) == (JobState.QUEUED, "broker_unavailable")
    responds = True
    reaper.reap()
    assert bench.store.jobs.get(job.id).waiting_for is None
    assert bench.store.jobs.get(job.id).state not in FINISHED


def test_every_change_of_wait_is_event(bench: RunnerBench) -> None:
    job = bench.create_job()
    before = bench.store.jobs.changes([job.id])[job.id]
    claim = bench.store.leases.claim("worker", 20.0)
    assert claim is not None
    claimed = bench.store.jobs.changes([job.id])[job.id]
    assert bench.store.leases.release(claim.chunk_id, claim.lease_token, waiting_for(Outage.ARTIFACTS, claim.stage))
    waiting = bench.store.jobs.changes([job.id])[job.id]
    assert len({change.event for change in (before, claimed, waiting)}) == 3
    again = bench.store.leases.claim("worker", 20.0)
    assert again is not None
    assert (again.chunk_id, again.attempt) == (claim.chunk_id, 1)
    assert bench.store.jobs.get(job.id).stages[0].state is ChunkState.RUNNING
