"""Rows of another tenant are not there."""

from collections.abc import Callable

import pytest

from pipeline.core.options.job_choices import VisualChoices
from pipeline.core.problems.code_group import Code
from tests.worker.store.conftest import PREFLIGHT, StoreBench, stages
from worker.store.database.quotas import Quotas
from worker.store.errors import NotFound
from worker.store.model.job_records import JobProblem
from worker.store.model.rights import Actor, LinkScope
from worker.store.model.work import Remake
from worker.store.repositories.jobs import Jobs, Results
from worker.store.repositories.links import Links
from worker.store.repositories.sessions import Edits, Sessions
from worker.store.repositories.visuals import Visuals
from worker.store.spec import JobSpec
from worker.store.tenant_records import TenantRecords


def make(jobs: StoreBench, tenant: str) -> tuple[TenantRecords, str, str]:
    """A tenant's records, with a session and a failed job."""
    records = jobs.store.tenant(tenant, Quotas(), Actor())
    session_id = records.sessions.add("take", [], PREFLIGHT, jobs.store.sessions.reserve_id()).id
    job_id = records.jobs.add(session_id, JobSpec(), stages(1)).id
    claim = jobs.claim()
    assert claim.job_id == job_id
    jobs.store.leases.fail(claim.chunk_id, claim.lease_token, JobProblem(Code("broken"), "It is broken."))
    return records, session_id, job_id


def test_lists_hold_tenant_s_own(jobs: StoreBench) -> None:
    (mine, my_session, my_job), (theirs, their_session, their_job) = make(jobs, "mine"), make(jobs, "theirs")
    assert [one.session.id for one in mine.sessions.page()] == [my_session]
    assert [one.session.id for one in theirs.sessions.page()] == [their_session]
    assert [one.id for one in mine.jobs.page()] == [my_job]
    assert set(mine.jobs.changes([my_job, their_job])) == {my_job}
    assert [one.id for one in jobs.store.jobs.page()] == [their_job, my_job]
    assert jobs.store.tenant("nobody").sessions.page() == []


Act = Callable[[TenantRecords, str, str], object]
ACTS: dict[str, Act] = {
    "sessions.get": lambda records, session_id, job_id: records.sessions.get(session_id),
    "sessions.capture": lambda records, session_id, job_id: records.sessions.capture(session_id),
    "sessions.locked": lambda records, session_id, job_id: records.sessions.locked(session_id),
    "sessions.rename": lambda records, session_id, job_id: records.sessions.rename(session_id, "mine"),
    "sessions.delete": lambda records, session_id, job_id: records.sessions.delete(session_id),
    "sessions.delete_videos": lambda records, session_id, job_id: records.sessions.delete_videos(session_id),
    "jobs.add": lambda records, session_id, job_id: records.jobs.add(session_id, JobSpec(), stages(1)),
    "jobs.get": lambda records, session_id, job_id: records.jobs.get(job_id),
    "jobs.attempts": lambda records, session_id, job_id: records.jobs.attempts(job_id),
    "results.downloads": lambda records, session_id, job_id: records.results.downloads(job_id),
    "results.all": lambda records, session_id, job_id: records.results.all(job_id),
    "results.listed": lambda records, session_id, job_id: records.results.listed(job_id, "person-1.bvh"),
    "results.get": lambda records, session_id, job_id: records.results.get(job_id, "person-1.bvh"),
    "links.add": lambda records, session_id, job_id: records.links.add(job_id, LinkScope.JOB, None, 60.0),
    "links.list_valid": lambda records, session_id, job_id: records.links.list_valid(job_id),
    "jobs.cancel": lambda records, session_id, job_id: records.jobs.cancel(job_id),
    "jobs.retry": lambda records, session_id, job_id: records.jobs.retry(job_id, stages(1)),
    "jobs.remake": lambda records, session_id, job_id: records.jobs.remake(
        job_id, lambda job: Remake(stages(1), has_visuals=False, needs_videos=False)
    ),
    "edits.get": lambda records, session_id, job_id: records.edits.get(session_id),
    "edits.replace": lambda records, session_id, job_id: records.edits.replace(session_id, ()),
    "visuals.add": lambda records, session_id, job_id: records.visuals.add(job_id, VisualChoices(), stages(1), 0),
    "jobs.delete": lambda records, session_id, job_id: records.jobs.delete(job_id),
}


@pytest.mark.parametrize("act", ACTS)
def test_records_of_other_tenant_are_unknown(jobs: StoreBench, act: str) -> None:
    theirs, session_id, job_id = make(jobs, "theirs")
    before = theirs.sessions.get(session_id), theirs.jobs.page()
    with pytest.raises(NotFound):
        ACTS[act](jobs.store.tenant("mine", Quotas(), Actor()), session_id, job_id)
    assert (theirs.sessions.get(session_id), theirs.jobs.page()) == before


def test_records_every_method_is_tried() -> None:
    public = {
        f"{resource.__name__.lower()}.{name}"
        for resource in (Sessions, Edits, Jobs, Visuals, Results, Links)
        for name in vars(resource)
        if not name.startswith("_")
    }
    assert public - set(ACTS) == {
        *("sessions.add", "sessions.page", "jobs.page", "jobs.changes", "jobs.reserve_copy"),
        "edits.people",  # None of another's: tests/api/web/test_edits.py
        *("visuals.due", "sessions.with_superfluous_videos"),  # the reaper asks for those of all tenants
        "results.proxy",  # None of another's: tests/worker/store/repositories/test_captures.py
        "results.blurred",  # None of another's: tests/worker/store/test_deleting_videos.py
        "links.revoke",  # tests/worker/store/repositories/test_links.py tries it
    }


def test_job_belongs_to_tenant_of_session(jobs: StoreBench) -> None:
    session_id = jobs.store.tenant("theirs").sessions.add("take", [], PREFLIGHT, jobs.store.sessions.reserve_id()).id
    job_id = jobs.store.jobs.add(session_id, JobSpec(), stages(1)).id
    assert [one.id for one in jobs.store.tenant("theirs").jobs.page()] == [job_id]
