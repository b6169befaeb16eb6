"""What is another tenant's is not there."""

from collections.abc import Callable

import pytest

from tests.worker.jobs.conftest import Bench, stages
from worker.jobs.database.quotas import Quotas
from worker.jobs.errors import NotFound
from worker.jobs.model import Actor, Problem
from worker.jobs.repositories.records import Records
from worker.jobs.spec import JobSpec

PREFLIGHT = {"cameras": [{"name": "cam"}], "timebase": {"num_frames": 60, "frame_rate_hz": 25.0}, "warnings": []}


def make(jobs: Bench, tenant: str) -> tuple[Records, str, str]:
    """A tenant's records, with a session and a failed job."""
    records = jobs.store.of(tenant, Quotas(), Actor())
    session_id = records.create_session("take", [], PREFLIGHT, jobs.store.announce_session()).id
    job_id = records.create_job(session_id, JobSpec(), stages(1)).id
    claim = jobs.claim()
    assert claim.job_id == job_id
    jobs.store.fail(claim.chunk_id, claim.lease_token, Problem("broken", "It is broken."))
    return records, session_id, job_id


def test_lists_hold_the_tenant_s_own(jobs: Bench) -> None:
    (mine, my_session, my_job), (theirs, their_session, their_job) = make(jobs, "mine"), make(jobs, "theirs")
    assert [one.id for one in mine.sessions()] == [my_session]
    assert [one.id for one in theirs.sessions()] == [their_session]
    assert [one.id for one in mine.jobs()] == [my_job]
    assert set(mine.changes([my_job, their_job])) == {my_job}
    assert [one.id for one in jobs.store.jobs()] == [their_job, my_job]
    assert jobs.store.of("nobody", Quotas(), Actor()).sessions() == []


Act = Callable[[Records, str, str], object]
ACTS: dict[str, Act] = {
    "session": lambda records, session_id, job_id: records.session(session_id),
    "delete_session": lambda records, session_id, job_id: records.delete_session(session_id),
    "create_job": lambda records, session_id, job_id: records.create_job(session_id, JobSpec(), stages(1)),
    "job": lambda records, session_id, job_id: records.job(job_id),
    "attempts": lambda records, session_id, job_id: records.attempts(job_id),
    "results": lambda records, session_id, job_id: records.results(job_id),
    "result": lambda records, session_id, job_id: records.result(job_id, "person-1.bvh"),
    "cancel": lambda records, session_id, job_id: records.cancel(job_id),
    "retry": lambda records, session_id, job_id: records.retry(job_id, stages(1)),
    "delete_job": lambda records, session_id, job_id: records.delete_job(job_id),
}


@pytest.mark.parametrize("act", ACTS)
def test_nothing_can_be_done_with_another_s(jobs: Bench, act: str) -> None:
    theirs, session_id, job_id = make(jobs, "theirs")
    before = theirs.session(session_id), theirs.jobs()
    with pytest.raises(NotFound):
        ACTS[act](jobs.store.of("mine", Quotas(), Actor()), session_id, job_id)
    assert (theirs.session(session_id), theirs.jobs()) == before


def test_every_act_is_tried() -> None:
    public = {name for name in vars(Records) if not name.startswith("_")}
    assert public - set(ACTS) == {
        "answering", "create_session", "create_session_and_job", "has_webhook_secret", "sessions", "jobs", "changes",
        "require_room", "usage",
    }  # fmt: skip


def test_a_job_is_of_its_session_s_tenant(jobs: Bench) -> None:
    session_id = (
        jobs.store.of("theirs", Quotas(), Actor())
        .create_session("take", [], PREFLIGHT, jobs.store.announce_session())
        .id
    )
    job_id = jobs.store.create_job(session_id, JobSpec(), stages(1)).id
    assert [one.id for one in jobs.store.of("theirs", Quotas(), Actor()).jobs()] == [job_id]
