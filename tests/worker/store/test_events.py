"""Events of jobs, and how far they have come."""

import sqlalchemy as sa

from pipeline.core.problems.code_group import Code
from tests.worker.store.conftest import LEASE_S, StoreBench, stages
from worker.store.database.tables import events
from worker.store.model.job_records import JobProblem


def noted(jobs: StoreBench, job_id: str) -> list[tuple[str, str]]:
    engine = sa.create_engine(jobs.url)
    with engine.connect() as connection:
        rows = connection.execute(sa.select(events).where(events.c.job_id == job_id).order_by(events.c.id)).all()
    engine.dispose()
    return [(row.kind, row.value) for row in rows]


def test_events_of_job_are_in_order(jobs: StoreBench) -> None:
    job = jobs.queue(num_chunks=2)
    jobs.finish_all()
    assert noted(jobs, job.id) == [
        ("state", "queued"),
        ("state", "running"),
        ("stage", "export"),
        ("state", "succeeded"),
    ]


def test_cancel_failure_and_retry_are_noted(jobs: StoreBench) -> None:
    canceled = jobs.queue()
    claim = jobs.claim()
    jobs.store.jobs.cancel(canceled.id)
    jobs.store.jobs.cancel(canceled.id)
    jobs.store.leases.release(claim.chunk_id, claim.lease_token)
    states = ["queued", "running", "canceling", "canceled"]
    assert noted(jobs, canceled.id) == [("state", state) for state in states]
    failed = jobs.queue()
    claim = jobs.claim()
    jobs.store.leases.fail(claim.chunk_id, claim.lease_token, JobProblem(Code("broken"), "It is broken."))
    jobs.store.jobs.retry(failed.id, stages())
    assert noted(jobs, failed.id) == [("state", state) for state in ("queued", "running", "failed", "queued")]


def test_changes_are_seen_and_nothing_else_is(jobs: StoreBench) -> None:
    job, other = jobs.queue(), jobs.queue()
    queued = jobs.store.jobs.changes([job.id, other.id, "nobody"])
    assert set(queued) == {job.id, other.id}
    assert jobs.store.jobs.changes([job.id]) == {job.id: queued[job.id]}
    claim = jobs.claim()
    running = jobs.store.jobs.changes([job.id])[job.id]
    assert running.event > queued[job.id].event
    assert jobs.store.leases.heartbeat(claim.chunk_id, claim.lease_token, 4, LEASE_S)
    further = jobs.store.jobs.changes([job.id])[job.id]
    assert (further.event, further.done) == (running.event, 4)
    assert jobs.store.jobs.changes([other.id]) == {other.id: queued[other.id]}
    assert jobs.store.jobs.changes([]) == {}


def test_numbers_are_not_used_again(jobs: StoreBench) -> None:
    job = jobs.queue()
    jobs.store.jobs.cancel(job.id)
    last = jobs.store.jobs.changes([job.id])[job.id].event
    jobs.store.jobs.delete(job.id)
    assert noted(jobs, job.id) == []
    assert jobs.store.jobs.changes([job.id]) == {}
    again = jobs.queue()
    assert jobs.store.jobs.changes([again.id])[again.id].event > last
