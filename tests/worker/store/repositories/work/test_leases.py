import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace

import pytest
import sqlalchemy as sa

from pipeline.core.problems.finding_codes import INPUT_ERROR
from pipeline.core.problems.request_codes import INTERNAL_ERROR
from tests.worker.store.conftest import EXPIRED_S, LEASE_S, PREFLIGHT, UNITS, StoreBench, result, stages
from worker.store.database.quotas import NO_QUOTAS
from worker.store.database.tables import chunks
from worker.store.model.job_records import JobProblem
from worker.store.model.rights import Actor, Scope
from worker.store.model.states import ChunkState, JobState
from worker.store.model.work import ChunkOutput, Claim, WorkerState, WorkerStatus
from worker.store.spec import JobSpec, Priority
from worker.store.store import MAX_ATTEMPTS, JobStore

PROBLEM = JobProblem(INTERNAL_ERROR, "The stage detect failed inside the service.", stage="detect", retryable=True)
FINAL = replace(PROBLEM, code=INPUT_ERROR, retryable=False)


def test_claim_has_all_that_worker_needs(jobs: StoreBench) -> None:
    job = jobs.queue()
    claim = jobs.claim()
    assert claim == Claim(
        chunk_id=claim.chunk_id,
        job_id=job.id,
        session_id=jobs.session_id,
        stage="detect",
        index=0,
        payload={"start_frame": 0},
        unit_count=UNITS,
        output_key="detect-0",
        spec=JobSpec(),
        lease_token=claim.lease_token,
        attempt=1,
        job_attempt=1,
        trace=None,
    )


def test_chunks_are_claimed_by_age_of_job_and_then_in_order(jobs: StoreBench) -> None:
    old, new = jobs.queue(2).id, jobs.queue(2).id
    claims = [jobs.claim() for _ in range(4)]
    assert [(claim.job_id, claim.index) for claim in claims] == [(old, 0), (old, 1), (new, 0), (new, 1)]
    assert len({claim.lease_token for claim in claims}) == 4
    assert jobs.store.leases.claim("worker", LEASE_S) is None


def test_chunks_are_claimed_by_priority_of_job_before_age(jobs: StoreBench) -> None:
    """A job of a higher priority takes the next free worker, also while one of a lower priority runs."""
    batch = jobs.queue(2, "batch")
    assert jobs.claim().job_id == batch.id
    first, second = jobs.queue(1), jobs.queue(1)
    later_batch, preview = jobs.queue(1, "batch"), jobs.queue(1, "preview")
    waiting = [jobs.store.jobs.get(job.id).queue_position for job in (preview, first, second, later_batch)]
    assert waiting == [1, 2, 3, 4]
    claimed = [jobs.claim().job_id for _ in range(5)]
    assert claimed == [preview.id, first.id, second.id, batch.id, later_batch.id]


def test_priority_is_kept_by_retry(jobs: StoreBench) -> None:
    preview, normal = jobs.queue(1, "preview"), jobs.queue(1)
    jobs.store.jobs.cancel(preview.id)
    jobs.store.jobs.retry(preview.id, stages(1))
    assert [jobs.claim().job_id for _ in range(2)] == [preview.id, normal.id]


def test_priority_takes_no_share_of_other_tenants(jobs: StoreBench) -> None:
    """The tenant with fewer running chunks is next, whatever the priorities of the other tenant's jobs are."""
    preview = jobs.queue(4, "preview").id
    assert jobs.claim().job_id == preview
    late = queue_of_other(jobs, 1, "batch")
    assert jobs.claim().job_id == late


def queue_of_other(jobs: StoreBench, num_chunks: int, priority: Priority = "normal") -> str:
    """Queue a job of another tenant; returns its id."""
    other = jobs.store.tenant("other", NO_QUOTAS, Actor())
    session_id = other.sessions.add("take", [], PREFLIGHT, jobs.store.sessions.reserve_id()).id
    return other.jobs.add(session_id, JobSpec(priority=priority), stages(num_chunks)).id


def test_queue_of_one_tenant_delays_no_other_tenant(jobs: StoreBench) -> None:
    """Tenants have equal shares of the chunks at work, however many jobs each has and whoever was first."""
    first = [jobs.queue(4).id for _ in range(3)]
    held = [jobs.claim() for _ in range(2)]
    assert {claim.job_id for claim in held} == {first[0]}
    late = queue_of_other(jobs, 6)
    claims = [jobs.claim() for _ in range(2)]
    assert [claim.job_id for claim in claims] == [late, late]
    shares = Counter(jobs.claim().job_id == late for _ in range(6))
    assert shares == {True: 3, False: 3}
    assert sum(1 for _ in iter(lambda: jobs.store.leases.claim("worker", LEASE_S), None)) == 12 + 6 - 10


def test_tenants_take_turns_on_one_worker(jobs: StoreBench) -> None:
    for _ in range(20):
        jobs.queue(4)
    late = queue_of_other(jobs, 1)

    def finish_one() -> str:
        claim = jobs.claim()
        jobs.finish(claim)
        return claim.job_id

    assert late in [finish_one() for _ in range(40)]  # by chance not, once in a million millions


def list_workers(jobs: StoreBench, num_workers: int) -> None:
    for number in range(num_workers):
        jobs.store.workers.report(WorkerStatus(f"host:{number}", WorkerState.READY, "works"))


def test_worker_stays_free_for_other_tenants(jobs: StoreBench) -> None:
    """However long a tenant's chunks take, and although the others have nothing to do when they begin."""
    for tenant in ("default", "other"):
        jobs.store.keys.add(tenant, "portal", {Scope.READ, Scope.WRITE})
    list_workers(jobs, 3)
    jobs.queue(4)
    held = [jobs.claim() for _ in range(2)]
    assert jobs.store.leases.claim("worker", LEASE_S) is None
    late = queue_of_other(jobs, 1)
    assert jobs.claim().job_id == late
    jobs.finish(held[0])
    assert jobs.claim().job_id == held[0].job_id


@pytest.mark.parametrize(
    ("keys", "num_workers"),
    [
        pytest.param({}, 2, id="no keys"),
        pytest.param({"default": Scope.WRITE, "operator": Scope.ADMIN}, 2, id="nobody else makes jobs"),
        pytest.param({"default": Scope.WRITE, "other": Scope.WRITE}, 0, id="workers are not listed"),
    ],
)
def test_tenant_without_others_gets_all_workers(jobs: StoreBench, keys: Mapping[str, Scope], num_workers: int) -> None:
    for tenant, scope in keys.items():
        jobs.store.keys.add(tenant, "key", {scope})
    list_workers(jobs, num_workers)
    jobs.queue(4)
    for _ in range(2):
        jobs.claim()


def test_key_revoked_reserves_no_worker(jobs: StoreBench) -> None:
    jobs.store.keys.add("default", "portal", {Scope.WRITE})
    revoked, _ = jobs.store.keys.add("other", "portal", {Scope.WRITE})
    jobs.store.keys.add("expired", "portal", {Scope.WRITE}, lifetime_s=-1.0)
    list_workers(jobs, 2)
    jobs.queue(4)
    jobs.claim()
    assert jobs.store.leases.claim("worker", LEASE_S) is None
    jobs.store.keys.revoke(revoked.id)
    jobs.claim()


def test_worker_alone_serves_all_tenants(jobs: StoreBench) -> None:
    for tenant in ("default", "other"):
        jobs.store.keys.add(tenant, "portal", {Scope.WRITE})
    list_workers(jobs, 1)
    jobs.queue(1)
    jobs.finish_all()


def test_without_jobs_there_is_nothing_to_claim(jobs: StoreBench) -> None:
    assert jobs.store.leases.claim("worker", LEASE_S) is None


def test_reduce_is_ready_when_whole_map_is_done(jobs: StoreBench) -> None:
    jobs.queue(num_chunks=3)
    claims = [jobs.claim() for _ in range(3)]
    assert [jobs.finish(claim) for claim in (claims[2], claims[0])] == [False, False]
    assert jobs.store.leases.claim("worker", LEASE_S) is None
    assert jobs.finish(claims[1])
    assert jobs.claim().stage == "export"


def test_stage_follows_one_before(jobs: StoreBench) -> None:
    detect, export = stages(2)
    job = jobs.store.jobs.add(jobs.session_id, JobSpec(), (detect, replace(export, name="fit"), export))
    order = []
    while claim := jobs.store.leases.claim("worker", LEASE_S):
        order.append((claim.stage, jobs.finish(claim)))
    assert order == [("detect", False), ("detect", True), ("fit", True), ("export", False)]
    assert jobs.store.jobs.get(job.id).state == JobState.SUCCEEDED


Report = Callable[[JobStore, int, str], bool]

REPORTS: dict[str, Report] = {
    "heartbeat": lambda store, chunk_id, token: store.leases.heartbeat(chunk_id, token, UNITS, LEASE_S),
    "finish": lambda store, chunk_id, token: store.leases.finish(
        chunk_id, token, "f" * 64, 1, results=[result("0", "of-nobody.bvh")]
    ),
    "fail": lambda store, chunk_id, token: store.leases.fail(chunk_id, token, FINAL),
    "release": lambda store, chunk_id, token: store.leases.release(chunk_id, token),
    "compute again": lambda store, chunk_id, token: store.leases.compute_again(chunk_id, token, "detect", {0}),
}


@pytest.mark.parametrize("report", REPORTS.values(), ids=REPORTS.keys())
def test_report_without_lease_changes_nothing(jobs: StoreBench, report: Report) -> None:
    job_id = jobs.queue(num_chunks=1).id
    lost = jobs.claim(EXPIRED_S)
    jobs.store.leases.reap(LEASE_S)
    holder = jobs.claim()
    assert holder.chunk_id == lost.chunk_id
    before = jobs.store.jobs.get(job_id)
    for token in (lost.lease_token, "", "no token"):
        assert not report(jobs.store, holder.chunk_id, token)
    assert not report(jobs.store, holder.chunk_id + 1000, holder.lease_token)
    assert jobs.store.jobs.get(job_id) == before
    assert jobs.store.outputs.find(jobs.session_id, holder.output_key) is None
    assert jobs.finish(holder)
    for token in (lost.lease_token, holder.lease_token):
        assert not report(jobs.store, holder.chunk_id, token)
    jobs.finish_all()
    assert [file.name for file in jobs.store.results.downloads(job_id)] == ["person-1.bvh"]


def test_heartbeat_keeps_lease(jobs: StoreBench) -> None:
    jobs.queue(num_chunks=1)
    claim = jobs.claim(EXPIRED_S)
    assert jobs.store.leases.heartbeat(claim.chunk_id, claim.lease_token, 1, LEASE_S)
    assert not jobs.store.leases.reap(LEASE_S)
    assert jobs.finish(claim)


def test_lease_ends_by_clock(jobs: StoreBench) -> None:
    jobs.queue(num_chunks=1)
    claim = jobs.claim(lease_s=0.3)
    assert not jobs.store.leases.reap(LEASE_S)
    time.sleep(0.4)
    assert jobs.store.leases.reap(LEASE_S)
    assert not jobs.store.leases.heartbeat(claim.chunk_id, claim.lease_token, 1, LEASE_S)


def test_clock_put_back_keeps_no_lease_alive(jobs: StoreBench) -> None:
    jobs.queue(num_chunks=2)
    lost, held = jobs.claim(lease_s=3600.0), jobs.claim(lease_s=3600.0)  # as if it had been an hour later
    assert not jobs.store.leases.reap(0.2)
    assert jobs.store.leases.heartbeat(held.chunk_id, held.lease_token, 1, LEASE_S)
    time.sleep(0.3)
    assert jobs.store.leases.reap(LEASE_S)
    assert not jobs.store.leases.heartbeat(lost.chunk_id, lost.lease_token, 1, LEASE_S)
    assert jobs.store.leases.heartbeat(held.chunk_id, held.lease_token, 1, LEASE_S)


def test_finish_late_counts_until_chunk_is_taken_back(jobs: StoreBench) -> None:
    jobs.queue(num_chunks=1)
    assert jobs.finish(jobs.claim(EXPIRED_S))


def test_progress_never_goes_back(jobs: StoreBench) -> None:
    job_id = jobs.queue(num_chunks=1).id
    total = 2 * UNITS
    claim = jobs.claim()
    seen = []
    for done_units in (4, 2, 7, 10_000):
        jobs.store.leases.heartbeat(claim.chunk_id, claim.lease_token, done_units, EXPIRED_S)
        seen.append(jobs.store.jobs.get(job_id).progress)
    assert seen == [4 / total, 4 / total, 7 / total, 10 / total]
    jobs.store.leases.reap(LEASE_S)
    claim = jobs.claim()
    jobs.store.leases.heartbeat(claim.chunk_id, claim.lease_token, 1, LEASE_S)
    assert jobs.store.jobs.get(job_id).progress == 10 / total


def test_failure_retryable_gets_another_try(jobs: StoreBench) -> None:
    job_id = jobs.queue(num_chunks=1).id
    for attempt in range(1, MAX_ATTEMPTS):
        claim = jobs.claim()
        assert claim.attempt == attempt
        assert jobs.store.leases.fail(claim.chunk_id, claim.lease_token, PROBLEM)
    claim = jobs.claim()
    assert not jobs.store.leases.fail(claim.chunk_id, claim.lease_token, PROBLEM)
    job = jobs.store.jobs.get(job_id)
    last = replace(PROBLEM, detail=f"{PROBLEM.detail} It was the last of {MAX_ATTEMPTS} tries.")
    assert (job.state, job.problem) == (JobState.FAILED, last)
    (whole,) = jobs.store.jobs.attempts(job_id)
    assert (whole.attempt, whole.state, whole.problem) == (1, JobState.FAILED, last)
    assert [(one.stage, one.chunk_index, one.chunk_try) for one in whole.failures] == [
        ("detect", 0, number) for number in range(1, MAX_ATTEMPTS + 1)
    ]
    assert {one.problem for one in whole.failures} == {PROBLEM}


def test_another_failure_ends_job_and_stops_its_workers(jobs: StoreBench) -> None:
    job_id = jobs.queue(num_chunks=4).id
    done, broken, other = jobs.claim(), jobs.claim(), jobs.claim()
    jobs.finish(done)
    assert not jobs.store.leases.fail(broken.chunk_id, broken.lease_token, FINAL)
    job = jobs.store.jobs.get(job_id)
    assert (job.state, job.problem, job.progress) == (JobState.FAILED, FINAL, UNITS / (5 * UNITS))
    assert [stage.state for stage in job.stages] == [ChunkState.FAILED, ChunkState.CANCELED]
    assert job.finished_at is not None
    assert not jobs.store.leases.heartbeat(other.chunk_id, other.lease_token, 1, LEASE_S)
    assert not jobs.finish(other)
    assert jobs.store.leases.claim("worker", LEASE_S) is None
    assert not jobs.store.leases.reap(LEASE_S)


def test_chunk_released_is_ready_and_lost_no_try(jobs: StoreBench) -> None:
    job_id = jobs.queue(num_chunks=1).id
    for _ in range(2 * MAX_ATTEMPTS):
        claim = jobs.claim()
        assert claim.attempt == 1
        assert jobs.store.leases.release(claim.chunk_id, claim.lease_token)
    assert jobs.store.jobs.get(job_id).state == JobState.RUNNING


def test_reap_says_whether_anything_is_ready(jobs: StoreBench) -> None:
    assert not jobs.store.leases.reap(LEASE_S)
    jobs.queue(num_chunks=1)
    canceled = jobs.queue(num_chunks=2)
    assert jobs.store.leases.reap(LEASE_S)
    jobs.claim()
    assert jobs.store.leases.reap(LEASE_S)  # of the other job
    jobs.store.jobs.cancel(canceled.id)
    assert not jobs.store.leases.reap(LEASE_S)
    jobs.queue(num_chunks=1)
    jobs.claim(EXPIRED_S)
    assert jobs.store.leases.reap(LEASE_S)


def test_worker_lost_too_often_ends_job(jobs: StoreBench) -> None:
    job_id = jobs.queue(num_chunks=2).id
    for attempt in range(1, MAX_ATTEMPTS + 1):
        assert jobs.store.jobs.get(job_id).state in {JobState.QUEUED, JobState.RUNNING}
        assert jobs.claim(EXPIRED_S).attempt == attempt
        jobs.store.leases.reap(LEASE_S)
        jobs.execute(sa.update(chunks).values(due_at=None))  # retries wait, see test_next_chunk
    job = jobs.store.jobs.get(job_id)
    assert job.state == JobState.FAILED
    assert job.problem is not None
    assert (job.problem.code, job.problem.stage) == ("worker_lost", "detect")
    assert not jobs.store.leases.reap(LEASE_S)


def test_reap_ends_canceled_job_whose_workers_are_gone(jobs: StoreBench) -> None:
    job_id = jobs.queue(num_chunks=2).id
    jobs.claim(EXPIRED_S)
    jobs.claim(EXPIRED_S)
    assert jobs.store.jobs.cancel(job_id).state == JobState.CANCELING
    assert not jobs.store.leases.reap(LEASE_S)
    assert jobs.store.jobs.get(job_id).state == JobState.CANCELED


def test_outputs_are_recorded_by_session(jobs: StoreBench) -> None:
    jobs.queue(num_chunks=1)
    claim = jobs.claim()
    assert jobs.store.outputs.find(jobs.session_id, claim.output_key) is None
    jobs.store.leases.finish(claim.chunk_id, claim.lease_token, "a" * 64, 3_000_000_000)
    assert jobs.store.outputs.find(jobs.session_id, claim.output_key) == ("a" * 64, 3_000_000_000)
    assert jobs.store.outputs.find("another", claim.output_key) is None


def test_output_last_record_counts(jobs: StoreBench) -> None:
    jobs.queue(num_chunks=1)
    jobs.queue(num_chunks=1)
    for sha256 in ("a" * 64, "b" * 64):
        claim = next(claim for claim in iter(jobs.claim, None) if claim.stage == "detect")
        jobs.store.leases.finish(claim.chunk_id, claim.lease_token, sha256, 1)
    assert jobs.store.outputs.find(jobs.session_id, "detect-0") == ("b" * 64, 1)


def start_reduce(jobs: StoreBench, num_chunks: int = 3) -> tuple[str, Claim]:
    """A job whose map is done and whose reduce runs."""
    job_id = jobs.queue(num_chunks).id
    for _ in range(num_chunks):
        jobs.finish(jobs.claim())
    claim = jobs.claim()
    assert claim.stage == "export"
    return job_id, claim


def test_outputs_damaged_are_computed_before_their_reader(jobs: StoreBench) -> None:
    job_id, reduce = start_reduce(jobs)
    before = jobs.store.jobs.get(job_id)
    assert jobs.store.leases.compute_again(reduce.chunk_id, reduce.lease_token, "detect", {0, 2})
    job = jobs.store.jobs.get(job_id)
    assert [stage.state for stage in job.stages] == [ChunkState.RUNNING, ChunkState.WAITING]
    assert job.progress == before.progress
    again = [jobs.claim(), jobs.claim()]
    assert [(claim.stage, claim.index, claim.attempt) for claim in again] == [("detect", 0, 2), ("detect", 2, 2)]
    assert jobs.store.leases.claim("worker", LEASE_S) is None
    assert [jobs.finish(claim) for claim in again] == [False, True]
    last = jobs.claim()
    assert (last.chunk_id, last.attempt) == (reduce.chunk_id, 1)
    jobs.finish(last)
    assert jobs.store.jobs.get(job_id).state == JobState.SUCCEEDED
    (attempt,) = jobs.store.jobs.attempts(job_id)
    assert [(one.chunk_index, one.problem.code) for one in attempt.failures] == [
        (0, "output_damaged"),
        (2, "output_damaged"),
    ]


def test_output_damaged_reported_twice_is_computed_once(jobs: StoreBench) -> None:
    detect, export = stages(2)
    (chunk,) = export.chunks
    chunks = tuple(replace(chunk, index=index, output_key=f"export-{index}") for index in range(3))
    job_id = jobs.store.jobs.add(jobs.session_id, JobSpec(), (detect, replace(export, chunks=chunks))).id
    for _ in range(2):
        jobs.finish(jobs.claim())
    first, second = jobs.claim(), jobs.claim()
    assert jobs.store.leases.compute_again(first.chunk_id, first.lease_token, "detect", {1})
    assert not jobs.store.leases.compute_again(second.chunk_id, second.lease_token, "detect", {1})
    again, third = jobs.claim(), jobs.claim()
    assert [(claim.stage, claim.index) for claim in (again, third)] == [("detect", 1), ("export", 2)]
    assert jobs.store.leases.claim("worker", LEASE_S) is None
    assert not jobs.finish(third)
    assert jobs.finish(again)
    assert [(claim.stage, claim.index) for claim in (jobs.claim(), jobs.claim())] == [("export", 0), ("export", 1)]
    assert jobs.store.jobs.get(job_id).state == JobState.RUNNING


def test_outputs_that_stay_damaged_end_job(jobs: StoreBench) -> None:
    job_id, reduce = start_reduce(jobs)
    for _ in range(MAX_ATTEMPTS - 1):
        assert jobs.store.leases.compute_again(reduce.chunk_id, reduce.lease_token, "detect", {1})
        jobs.finish(jobs.claim())
        reduce = jobs.claim()
    assert not jobs.store.leases.compute_again(reduce.chunk_id, reduce.lease_token, "detect", {0, 1, 2})
    job = jobs.store.jobs.get(job_id)
    assert job.state == JobState.FAILED
    assert job.problem is not None
    assert (job.problem.code, job.problem.retryable) == ("output_damaged", True)
    assert "chunk 1 of the stage detect" in job.problem.detail
    assert f"the last of {MAX_ATTEMPTS} tries" in job.problem.detail
    assert jobs.store.leases.claim("worker", LEASE_S) is None


def test_outputs_bear_digests_that_they_were_finished_with(jobs: StoreBench) -> None:
    job_id = jobs.queue(num_chunks=2).id
    jobs.finish(jobs.claim())
    outputs = jobs.store.outputs.list_stage(job_id, "detect")
    assert outputs == [ChunkOutput(0, "detect-0", "detect-0".ljust(64, "0")), ChunkOutput(1, "detect-1", None)]
