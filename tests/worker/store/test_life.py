"""Any order of calls, by clients and workers, keeps what jobs promise."""

import shutil
import tempfile
from pathlib import Path

import sqlalchemy as sa
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from pipeline.core.problems.code_group import Code
from tests.worker.store.conftest import EXPIRED_S, LEASE_S, UNITS, StoreBench, new_session, stages
from worker.store.database.tables import chunks
from worker.store.model.job_records import JobProblem
from worker.store.model.states import FINISHED, ChunkState, JobState
from worker.store.model.work import Claim
from worker.store.store import JobStore


class Life(RuleBasedStateMachine):
    """Two jobs of one session, and workers who do as they please."""

    def __init__(self) -> None:
        super().__init__()
        self._folder = Path(tempfile.mkdtemp())
        url = f"sqlite:///{self._folder / 'jobs.db'}"
        store = JobStore(url)
        store.migrate()
        self._bench = StoreBench(url, store, new_session(store))
        self._store = store
        self._claims: list[Claim] = []
        self._progress: dict[tuple[str, int], float] = {}

    @initialize(num_chunks=st.integers(1, 3))
    def queue(self, num_chunks: int) -> None:
        for _ in range(2):
            self._bench.queue(num_chunks)

    @rule(lease_s=st.sampled_from([LEASE_S, EXPIRED_S]))
    def claim(self, lease_s: float) -> None:
        claim = self._store.leases.claim("worker", lease_s)
        if claim is not None:
            assert claim.lease_token not in {old.lease_token for old in self._claims}
            self._claims.append(claim)

    # A claim is never forgotten: its worker may speak up long after it has lost its lease.

    @precondition(lambda self: self._claims)
    @rule(data=st.data(), done_units=st.integers(0, 2 * UNITS))
    def heartbeat(self, data: st.DataObject, done_units: int) -> None:
        claim = data.draw(st.sampled_from(self._claims))
        self._store.leases.heartbeat(claim.chunk_id, claim.lease_token, done_units, LEASE_S)

    @precondition(lambda self: self._claims)
    @rule(data=st.data())
    def finish(self, data: st.DataObject) -> None:
        self._bench.finish(data.draw(st.sampled_from(self._claims)))

    @precondition(lambda self: self._claims)
    @rule(data=st.data(), retryable=st.booleans())
    def fail(self, data: st.DataObject, retryable: bool) -> None:
        claim = data.draw(st.sampled_from(self._claims))
        self._store.leases.fail(
            claim.chunk_id, claim.lease_token, JobProblem(Code("bad"), "It failed.", retryable=retryable)
        )

    @precondition(lambda self: self._claims)
    @rule(data=st.data())
    def release(self, data: st.DataObject) -> None:
        claim = data.draw(st.sampled_from(self._claims))
        self._store.leases.release(claim.chunk_id, claim.lease_token)

    @rule()
    def reap(self) -> None:
        self._store.leases.reap(LEASE_S)

    @rule(which=st.integers(0, 1))
    def cancel_or_retry(self, which: int) -> None:
        job = self._store.jobs.page()[which]
        if job.state not in FINISHED:
            self._store.jobs.cancel(job.id)
        elif job.state != JobState.SUCCEEDED:
            self._store.jobs.retry(job.id, stages(2))

    @invariant()
    def progress_never_goes_back_within_an_attempt(self) -> None:
        for job in self._store.jobs.page():
            attempt = (job.id, job.attempt)
            assert self._progress.get(attempt, 0.0) <= job.progress <= 1.0
            self._progress[attempt] = job.progress

    @invariant()
    def an_unfinished_job_has_something_left_that_somebody_will_do(self) -> None:
        under_way = {ChunkState.READY, ChunkState.RUNNING}
        for job in self._store.jobs.page():
            states = {stage.state for stage in job.stages}
            if job.state in FINISHED:
                assert not states & (under_way | {ChunkState.WAITING})
            else:
                assert states & under_way

    @invariant()
    def success_means_all_done_with_results(self) -> None:
        for job in self._store.jobs.page():
            if job.state == JobState.SUCCEEDED:
                assert {stage.state for stage in job.stages} == {ChunkState.DONE}
                assert job.progress == 1.0
                assert [result.name for result in self._store.results.downloads(job.id)] == ["person-1.bvh"]
            assert (job.problem is not None) == (job.state == JobState.FAILED)

    def teardown(self) -> None:
        """Whatever happened, honest workers bring every job to its end."""
        for claim in self._claims:
            self._store.leases.release(claim.chunk_id, claim.lease_token)
        self._bench.execute(sa.update(chunks).values(due_at=None))  # a chunk that was lost twice waits for 20 s
        self._bench.finish_all()
        assert all(job.state in FINISHED for job in self._store.jobs.page())
        self._store.close()
        shutil.rmtree(self._folder)


Life.TestCase.settings = settings(max_examples=10, stateful_step_count=25, deadline=None)
TestLife = Life.TestCase
