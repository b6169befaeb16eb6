"""Counted totals, from which deleting jobs takes nothing back."""

import time

from pipeline.core.problems.code_group import Code
from tests.worker.store.conftest import EXPIRED_S, LEASE_S, UNITS, StoreBench
from worker.store.model.job_records import JobProblem


def test_totals_of_job_count_chunks_time_and_end(jobs: StoreBench) -> None:
    job = jobs.queue(num_chunks=2)
    before = jobs.store.figures()
    assert (before.totals, before.jobs, before.chunks) == ({}, {"queued": 1}, {"ready": 2, "waiting": 1})
    time.sleep(0.1)
    assert 0.05 < jobs.store.figures().longest_queued_s < 60.0
    claim = jobs.claim()
    time.sleep(0.2)
    jobs.finish(claim)
    second = jobs.claim()
    jobs.store.leases.finish(second.chunk_id, second.lease_token, "5" * 64, 7, reused=True)
    half = jobs.store.figures()
    assert half.longest_queued_s == 0.0
    assert 0.15 < half.totals["chunk_seconds", "detect"] < 60.0
    assert {key: value for key, value in half.totals.items() if key[0] != "chunk_seconds"} == {
        ("chunks_done", "detect"): 1.0,
        ("chunks_reused", "detect"): 1.0,
        ("chunk_units", "detect"): UNITS,
    }
    assert half.chunks == {"ready": 1}
    jobs.finish_all()
    done = jobs.store.figures()
    assert done.totals["jobs_ended", "succeeded"] == done.totals["chunks_done", "export"] == 1.0
    assert (done.jobs, done.chunks) == ({"succeeded": 1}, {})
    jobs.store.jobs.delete(job.id)
    after = jobs.store.figures()
    assert (after.totals, after.jobs) == (done.totals, {})


def test_lost_leases_and_other_tries(jobs: StoreBench) -> None:
    jobs.queue(num_chunks=1)
    jobs.claim(EXPIRED_S)
    jobs.store.leases.reap(LEASE_S)
    claim = jobs.claim()
    jobs.store.leases.fail(claim.chunk_id, claim.lease_token, JobProblem(Code("away"), "It is away.", retryable=True))
    claim = jobs.claim()
    jobs.store.leases.fail(claim.chunk_id, claim.lease_token, JobProblem(Code("broken"), "It is broken."))
    # A report that nobody wants any more counts nothing.
    jobs.store.leases.fail(claim.chunk_id, claim.lease_token, JobProblem(Code("broken"), "It is broken."))
    assert jobs.store.figures().totals == {
        ("leases_lost", "detect"): 1.0,
        ("chunks_retried", "detect"): 2.0,
        ("jobs_ended", "failed"): 1.0,
    }
