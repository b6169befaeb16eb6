"""Chunks that take much longer than others are begun a second time, and the first worker to finish counts."""

from collections.abc import Callable

import pytest
import sqlalchemy as sa

from pipeline.core.options.providers import CPU
from pipeline.core.problems.model import Code
from tests.worker.store.conftest import EXPIRED_S, LEASE_S, UNITS, StoreBench
from tests.worker.store.repositories.work.test_workers import with_provider
from worker.store.database.connection import now
from worker.store.database.tables import chunks
from worker.store.database.totals import Total
from worker.store.model.jobs import JobProblem
from worker.store.model.rights import Scope
from worker.store.model.states import ChunkState, JobState
from worker.store.model.work import Claim
from worker.store.repositories.work.stragglers import SHORTEST_S, SLOWER

PEER_S = 4.0


def begin(
    jobs: StoreBench, num_peers: int = 3, seconds: float = 1.01 * SLOWER * PEER_S, lease_s: float = LEASE_S
) -> Claim:
    """A chunk that has run for some time, beside finished ones that took ``PEER_S`` each."""
    jobs.queue(num_peers + 1)
    held = [jobs.claim(lease_s if number == 0 else LEASE_S) for number in range(num_peers + 1)]
    for claim in held[1:]:
        jobs.finish(claim)
    is_done = chunks.c.state == ChunkState.DONE
    jobs.execute(sa.update(chunks).where(is_done).values(claimed_at=chunks.c.finished_at - PEER_S))
    set_age(jobs, seconds)
    return held[0]


def set_age(jobs: StoreBench, seconds: float) -> None:
    is_running = chunks.c.state == ChunkState.RUNNING
    jobs.execute(sa.update(chunks).where(is_running).values(claimed_at=now() - seconds))


def copy(jobs: StoreBench, worker: str = "other", lease_s: float = LEASE_S) -> Claim | None:
    return jobs.store.leases.claim(worker, lease_s)


def test_an_idle_worker_begins_a_straggler_a_second_time_and_the_first_to_finish_counts(jobs: StoreBench) -> None:
    slow = begin(jobs)
    fast = copy(jobs)
    assert fast is not None
    assert (fast.chunk_id, fast.output_key, fast.attempt) == (slow.chunk_id, slow.output_key, slow.attempt)
    assert fast.lease_token != slow.lease_token
    assert copy(jobs, "third") is None  # never more than two
    assert jobs.store.leases.heartbeat(slow.chunk_id, slow.lease_token, 1, LEASE_S)
    assert jobs.store.leases.heartbeat(fast.chunk_id, fast.lease_token, 1, LEASE_S)
    assert jobs.finish(fast)
    assert not jobs.store.leases.heartbeat(slow.chunk_id, slow.lease_token, 2, LEASE_S)
    assert not jobs.finish(slow)
    jobs.finish_all()
    job = jobs.store.jobs.page()[0]
    assert (job.state, [stage.done for stage in job.stages]) == (JobState.SUCCEEDED, [4 * UNITS, UNITS])
    totals = jobs.store.figures().totals
    assert totals[Total.CHUNKS_COPIED, "detect"] == totals[Total.COPIES_FIRST, "detect"] == 1
    assert totals[Total.CHUNKS_DONE, "detect"] == 4


def test_the_first_worker_may_still_win(jobs: StoreBench) -> None:
    slow = begin(jobs)
    late = copy(jobs)
    assert late is not None
    assert jobs.finish(slow)
    assert not jobs.finish(late)
    assert (Total.COPIES_FIRST, "detect") not in jobs.store.figures().totals


@pytest.mark.parametrize(
    ("num_peers", "seconds"), [(3, 0.5 * SLOWER * PEER_S), (2, 100.0)], ids=["not long enough", "too few peers"]
)
def test_other_chunks_have_one_worker(jobs: StoreBench, num_peers: int, seconds: float) -> None:
    begin(jobs, num_peers, seconds)
    assert copy(jobs) is None


def test_a_short_time_makes_no_straggler(jobs: StoreBench) -> None:
    begin(jobs)
    jobs.execute(sa.update(chunks).where(chunks.c.state == ChunkState.DONE).values(claimed_at=chunks.c.finished_at))
    set_age(jobs, 0.5 * SHORTEST_S)
    assert copy(jobs) is None
    set_age(jobs, 1.1 * SHORTEST_S)
    assert copy(jobs) is not None


def test_a_worker_does_not_copy_its_own_chunk(jobs: StoreBench) -> None:
    begin(jobs)
    assert copy(jobs, "worker") is None


def test_ready_chunks_come_before_stragglers(jobs: StoreBench) -> None:
    slow = begin(jobs)
    job_id = jobs.queue(1).id
    first, second = copy(jobs), copy(jobs)
    assert first is not None
    assert first.job_id == job_id
    assert second is not None
    assert second.chunk_id == slow.chunk_id


def test_long_chunks_are_compared_by_their_units(jobs: StoreBench) -> None:
    slow = begin(jobs)
    jobs.execute(sa.update(chunks).where(chunks.c.id == slow.chunk_id).values(unit_count=10 * UNITS))
    assert copy(jobs) is None


Leave = Callable[[StoreBench, Claim], bool]
LEAVES: dict[str, Leave] = {
    "releases": lambda jobs, claim: jobs.store.leases.release(claim.chunk_id, claim.lease_token),
    "fails": lambda jobs, claim: jobs.store.leases.fail(
        claim.chunk_id, claim.lease_token, JobProblem(Code("broken"), "It is broken.")
    ),
}


@pytest.mark.parametrize("leave", LEAVES.values(), ids=LEAVES)
@pytest.mark.parametrize("is_copy", [False, True], ids=["first", "second"])
def test_a_worker_that_leaves_a_chunk_leaves_it_to_the_other_one(jobs: StoreBench, leave: Leave, is_copy: bool) -> None:
    slow = begin(jobs)
    fast = copy(jobs)
    assert fast is not None
    gone, left = (fast, slow) if is_copy else (slow, fast)
    assert not leave(jobs, gone)
    assert not jobs.store.leases.heartbeat(gone.chunk_id, gone.lease_token, 1, LEASE_S)
    assert jobs.store.leases.heartbeat(left.chunk_id, left.lease_token, 1, LEASE_S)
    assert jobs.finish(left)
    assert jobs.store.jobs.get(slow.job_id).state == JobState.RUNNING


def test_a_silent_first_worker_costs_no_try(jobs: StoreBench) -> None:
    slow = begin(jobs, lease_s=EXPIRED_S)
    fast = copy(jobs)
    assert fast is not None
    jobs.store.leases.reap(LEASE_S)
    assert jobs.store.leases.heartbeat(fast.chunk_id, fast.lease_token, 1, LEASE_S)
    assert not jobs.store.leases.heartbeat(slow.chunk_id, slow.lease_token, 1, LEASE_S)
    assert jobs.finish(fast)
    assert jobs.store.jobs.attempts(slow.job_id)[0].failures == ()
    assert jobs.store.figures().totals[Total.LEASES_LOST, "detect"] == 1


def test_a_silent_second_worker_makes_room_for_another(jobs: StoreBench) -> None:
    slow = begin(jobs)
    lost = copy(jobs, lease_s=EXPIRED_S)
    assert lost is not None
    assert jobs.store.leases.reap(LEASE_S)  # the straggler is worth a message
    again = copy(jobs, "third")
    assert again is not None
    assert not jobs.finish(lost)
    assert jobs.finish(again)
    assert not jobs.finish(slow)


def test_a_canceled_job_ends_for_both(jobs: StoreBench) -> None:
    slow = begin(jobs)
    fast = copy(jobs)
    assert fast is not None
    jobs.store.jobs.cancel(slow.job_id)
    for claim in (fast, slow):
        assert not jobs.store.leases.heartbeat(claim.chunk_id, claim.lease_token, 1, LEASE_S)
        assert not jobs.store.leases.release(claim.chunk_id, claim.lease_token)
    assert jobs.store.jobs.get(slow.job_id).state == JobState.CANCELED


def test_a_copy_counts_for_the_share_of_its_tenant(jobs: StoreBench) -> None:
    for tenant in ("one", "two"):
        jobs.store.keys.add(tenant, "key", {Scope.WRITE})
    for number in range(2):
        jobs.store.workers.report(with_provider(number, CPU))
    begin(jobs, num_peers=0)
    begin_peers(jobs)
    assert copy(jobs) is None  # one of the two workers stays free for the other tenant


def begin_peers(jobs: StoreBench) -> None:
    """Make finished chunks of the running one's stage."""
    with_state = sa.select(chunks.c.job_id).where(chunks.c.state == ChunkState.RUNNING)
    rows = [
        {"stage_index": 0, "stage": "detect", "chunk_index": number, "payload": {}, "output_key": f"k{number}",
         "unit_count": UNITS, "state": ChunkState.DONE, "claimed_at": 0.0, "finished_at": PEER_S}
        for number in range(10, 13)
    ]  # fmt: skip
    for row in rows:
        jobs.execute(sa.insert(chunks).values(job_id=with_state.scalar_subquery(), **row))
