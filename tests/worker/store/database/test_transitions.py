"""Every move of a job that the store can be asked for, from every state."""

from collections.abc import Callable
from itertools import product

import pytest
import sqlalchemy as sa

from pipeline.core.problems.finding_codes import INPUT_ERROR
from pipeline.core.problems.request_codes import INTERNAL_ERROR
from tests.worker.store.conftest import EXPIRED_S, LEASE_S, StoreBench, stages
from worker.store.database import tables
from worker.store.database.connection import Database
from worker.store.database.rows import stage_state
from worker.store.database.transitions import move_job
from worker.store.errors import Conflict
from worker.store.model.job_records import JobProblem
from worker.store.model.states import FINISHED, JOB_TRANSITIONS, ChunkState, JobState
from worker.store.model.work import Claim
from worker.store.spec import JobSpec
from worker.store.store import JobStore

Q, R, CG = JobState.QUEUED, JobState.RUNNING, JobState.CANCELING
S, F, C, E = JobState.SUCCEEDED, JobState.FAILED, JobState.CANCELED, JobState.EXPIRED

RETRYABLE = JobProblem(INTERNAL_ERROR, "It failed.", retryable=True)
FINAL = JobProblem(INPUT_ERROR, "It is broken.")


def bring_to(jobs: StoreBench, state: JobState) -> tuple[str, Claim | None]:
    """A job of one chunk in a state, and the claim of its chunk if a worker holds, or held, one."""
    job_id = jobs.store.jobs.add(jobs.session_id, JobSpec(), stages(1)[:1]).id
    if state == Q:
        return job_id, None
    if state == C:
        jobs.store.jobs.cancel(job_id)
        return job_id, None
    claim = jobs.claim(EXPIRED_S)
    if state == CG:
        jobs.store.jobs.cancel(job_id)
    elif state == F:
        jobs.store.leases.fail(claim.chunk_id, claim.lease_token, FINAL)
    elif state in {S, E}:
        jobs.finish(claim)
    if state == E:
        jobs.execute(sa.update(tables.jobs).values(state=E))
    assert jobs.store.jobs.get(job_id).state == state
    return job_id, claim


Action = Callable[[JobStore, str, int, str], object]

ACTIONS: dict[str, Action] = {
    "cancel": lambda store, job_id, *_: store.jobs.cancel(job_id),
    "retry": lambda store, job_id, *_: store.jobs.retry(job_id, stages(1)),
    "claim": lambda store, *_: store.leases.claim("worker", LEASE_S),
    "reap": lambda store, *_: store.leases.reap(LEASE_S),
    "heartbeat": lambda store, _, chunk_id, token: store.leases.heartbeat(chunk_id, token, 1, LEASE_S),
    "finish": lambda store, _, chunk_id, token: store.leases.finish(chunk_id, token, "0" * 64, 1),
    "release": lambda store, _, chunk_id, token: store.leases.release(chunk_id, token),
    "compute again": lambda store, _, chunk_id, token: store.leases.compute_again(chunk_id, token, "none", {0}),
    "fail, retryable": lambda store, _, chunk_id, token: store.leases.fail(chunk_id, token, RETRYABLE),
    "fail": lambda store, _, chunk_id, token: store.leases.fail(chunk_id, token, FINAL),
}

# All that is not named here leaves the job as it is.
MOVES = {
    (Q, "cancel"): C,
    (R, "cancel"): CG,
    (F, "retry"): Q,
    (C, "retry"): Q,
    (Q, "claim"): R,
    (CG, "reap"): C,
    (R, "finish"): S,
    (CG, "finish"): C,
    (CG, "release"): C,
    (CG, "fail, retryable"): C,
    (CG, "compute again"): C,
    (R, "fail"): F,
    (CG, "fail"): C,
}
CONFLICTS = {(state, "cancel") for state in FINISHED} | {(state, "retry") for state in (Q, R, CG, S, E)}


@pytest.mark.parametrize("state", JobState)
def test_action_in_state_moves_or_refuses(jobs: StoreBench, state: JobState) -> None:
    database = Database(jobs.url)
    for action, act in ACTIONS.items():
        job_id, claim = bring_to(jobs, state)
        with database.reading() as connection:
            chunk_id = connection.execute(sa.select(tables.chunks.c.id)).scalar_one()
        token = claim.lease_token if claim else ""
        before = jobs.store.jobs.get(job_id)
        if (state, action) in CONFLICTS:
            with pytest.raises(Conflict):
                act(jobs.store, job_id, chunk_id, token)
            assert jobs.store.jobs.get(job_id) == before, action
        else:
            act(jobs.store, job_id, chunk_id, token)
            after = jobs.store.jobs.get(job_id)
            assert after.state == MOVES.get((state, action), state), action
            assert (after.finished_at is not None) == (after.state in FINISHED), action
            assert (after.queue_position is not None) == (after.state == Q), action
        # The next action finds no other job, and no output that its job could use again.
        with database.writing() as connection:
            connection.execute(sa.delete(tables.jobs))
            connection.execute(sa.delete(tables.artifacts))
    database.close()


@pytest.mark.parametrize("state", JobState)
def test_delete_of_unfinished_job_is_refused(jobs: StoreBench, state: JobState) -> None:
    job_id, _ = bring_to(jobs, state)
    if state in FINISHED:
        jobs.store.jobs.delete(job_id)
        jobs.store.sessions.delete(jobs.session_id)
        return
    with pytest.raises(Conflict):
        jobs.store.jobs.delete(job_id)
    with pytest.raises(Conflict):
        jobs.store.sessions.delete(jobs.session_id)
    assert jobs.store.jobs.get(job_id).state == state


def test_job_moves_along_table_alone(jobs: StoreBench) -> None:
    job_id = jobs.queue().id
    database = Database(jobs.url)
    with database.writing() as connection:
        for source, target in product(JobState, JobState):
            connection.execute(sa.update(tables.jobs).values(state=source))
            legal = target in JOB_TRANSITIONS[source]
            assert move_job(connection, job_id, target) == legal
            assert connection.scalar(sa.select(tables.jobs.c.state)) == (target if legal else source)
    database.close()


@pytest.mark.parametrize(
    ("states", "expected"),
    [
        ("waiting waiting", "waiting"),
        ("ready ready", "ready"),
        ("ready running", "running"),
        ("ready done", "running"),
        ("done running", "running"),
        ("done done", "done"),
        ("done canceled", "canceled"),
        ("running canceled", "running"),
        ("done failed canceled", "failed"),
    ],
)
def test_state_of_stage(states: str, expected: str) -> None:
    assert stage_state(ChunkState(state) for state in states.split()) == expected
