"""Results whose time is over, and how long a job still takes."""

import time

import pytest

from pipeline.core.problems.code_group import Code
from tests.worker.store.conftest import LEASE_S, StoreBench, stages
from worker.store.errors import Conflict
from worker.store.model.job_records import JobProblem, JobRecord
from worker.store.model.states import JobState
from worker.store.spec import JobSpec


def queue(jobs: StoreBench, retention_s: float | None) -> JobRecord:
    return jobs.store.jobs.add(jobs.session_id, JobSpec(), stages(), retention_s)


def test_results_are_kept_for_as_long_as_was_said(jobs: StoreBench) -> None:
    job = queue(jobs, 3600.0)
    assert job.expires_at is None
    jobs.finish_all()
    done = jobs.store.jobs.get(job.id)
    assert done.finished_at is not None
    assert done.expires_at is not None
    assert (done.expires_at - done.finished_at).total_seconds() == pytest.approx(3600.0, abs=0.1)
    assert jobs.store.removals.expire_jobs() == []
    assert jobs.store.jobs.get(job.id).state is JobState.SUCCEEDED


def test_without_time_they_stay(jobs: StoreBench) -> None:
    job = queue(jobs, None)
    jobs.finish_all()
    assert jobs.store.jobs.get(job.id).expires_at is None
    assert jobs.store.removals.expire_jobs() == []


def test_job_expired_is_due_once(jobs: StoreBench) -> None:
    job, other = queue(jobs, 0.01), queue(jobs, None)
    jobs.finish_all()
    time.sleep(0.05)
    finished_at = jobs.store.jobs.get(job.id).finished_at
    assert jobs.store.removals.expire_jobs() == [job.id]
    assert [removal.prefix for removal in jobs.store.removals.due()] == [
        f"jobs/{job.id}/interim/1/",
        f"jobs/{other.id}/interim/1/",
        f"jobs/{job.id}/",
    ]
    expired = jobs.store.jobs.get(job.id)
    assert (expired.state, expired.finished_at) == (JobState.EXPIRED, finished_at)
    assert jobs.store.removals.expire_jobs() == []
    assert jobs.store.jobs.get(other.id).state is JobState.SUCCEEDED
    with pytest.raises(Conflict):
        jobs.store.jobs.retry(job.id, stages())
    assert [one.name for one in jobs.store.results.downloads(job.id)] == ["person-1.bvh"]
    jobs.store.jobs.delete(job.id)


def test_job_retried_is_not_due(jobs: StoreBench) -> None:
    job = queue(jobs, 0.01)
    claim = jobs.claim()
    jobs.store.leases.fail(claim.chunk_id, claim.lease_token, JobProblem(Code("broken"), "It is broken."))
    jobs.store.jobs.retry(job.id, stages())
    time.sleep(0.05)
    assert jobs.store.jobs.get(job.id).expires_at is None
    assert jobs.store.removals.expire_jobs() == []
    jobs.store.jobs.cancel(job.id)
    time.sleep(0.05)
    assert jobs.store.removals.expire_jobs() == [job.id]


def test_eta_is_derived_from_finished_work(jobs: StoreBench) -> None:
    job = queue(jobs, None)
    assert jobs.store.jobs.get(job.id).eta_s is None
    claim = jobs.claim()
    time.sleep(0.4)
    assert jobs.store.jobs.get(job.id).eta_s is None
    jobs.store.leases.heartbeat(claim.chunk_id, claim.lease_token, 5, LEASE_S)
    # 5 of 30 units of its stage in 0.4 s or, on a busy machine, more; less for the 10 units of the next stage.
    eta_s = jobs.store.jobs.get(job.id).eta_s
    assert eta_s is not None
    assert 5 * 0.4 <= eta_s + 0.1 < 7 * 30.0
    jobs.finish(claim)
    jobs.finish_all()
    assert jobs.store.jobs.get(job.id).eta_s is None
