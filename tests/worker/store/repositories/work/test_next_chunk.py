"""Next chunk of a worker: shares of tenants, abilities of workers, and chunks whose tries cost their workers."""

from collections import Counter
from dataclasses import replace
from functools import partial

import pytest
import sqlalchemy as sa

from pipeline.core.options.providers import CPU, Provider
from pipeline.core.problems.finding_codes import TIME_LIMIT
from tests.worker.store.conftest import EXPIRED_S, LEASE_S, StoreBench, stages
from tests.worker.store.repositories.work.test_workers import READY
from worker.store.database.connection import now
from worker.store.database.tables import chunks
from worker.store.model.job_records import JobProblem
from worker.store.model.session_records import Session
from worker.store.model.states import ChunkState, JobState
from worker.store.model.work import Ability, ChunkPlan, Claim, StagePlan, WorkerStatus
from worker.store.spec import JobSpec
from worker.store.store import JobStore

TENANTS = ("one", "two", "three")


def test_tenants_take_turns_at_one_worker(jobs: StoreBench) -> None:
    for tenant in TENANTS:
        records = jobs.store.tenant(tenant)
        session_id = records.sessions.reserve_id()
        template = jobs.store.sessions.get(jobs.session_id)
        records.sessions.add("take", template.files, template.preflight, session_id)
        records.jobs.add(session_id, JobSpec(), stages(12))
    owners = []
    for _ in range(4 * len(TENANTS)):
        claim = jobs.store.leases.claim("worker", LEASE_S)
        assert claim is not None
        owners.append(claim.session_id)
        jobs.finish(claim)
    turns = [set(owners[k : k + len(TENANTS)]) for k in range(0, len(owners), len(TENANTS))]
    assert [len(turn) for turn in turns] == [len(TENANTS)] * 4
    assert set(Counter(owners).values()) == {4}


GPU = Provider("cuda", "1.31.1", "NVIDIA H200")
OF_NETWORKS, OF_REST = "a" * 64, "b" * 64
WITH_GPU = Ability(frozenset({OF_NETWORKS, OF_REST}), frozenset({OF_NETWORKS}))
WITHOUT_GPU = Ability(frozenset({OF_REST}))
MIB = 2**20


def queue_for_ability(jobs: StoreBench, stage: str, code: str, memory_bytes: int = 0, num_chunks: int = 1) -> str:
    chunks = tuple(ChunkPlan(k, {}, 1, f"{stage}-{k}", memory_bytes) for k in range(num_chunks))
    return jobs.store.jobs.add(jobs.session_id, JobSpec(), (StagePlan(stage, chunks, code),)).id


def list_worker(jobs: StoreBench, name: str, provider: Provider, codes: tuple[str, ...], memory_bytes: int = 0) -> None:
    worker = replace(READY, id=name, provider=provider, codes=codes, memory_bytes=memory_bytes)
    jobs.store.workers.report(worker)


def take(jobs: StoreBench, ability: Ability, worker: str = "gpu:1") -> Claim | None:
    return jobs.store.leases.claim(worker, LEASE_S, ability)


def stage_of(claim: Claim | None) -> str | None:
    return None if claim is None else claim.stage


def test_gpu_takes_networks_first_beside_others(jobs: StoreBench) -> None:
    list_worker(jobs, "gpu:1", GPU, (OF_NETWORKS, OF_REST))
    list_worker(jobs, "cpu:1", CPU, (OF_REST,))
    queue_for_ability(jobs, "fit", OF_REST, num_chunks=2)
    queue_for_ability(jobs, "detect", OF_NETWORKS)
    assert stage_of(take(jobs, WITH_GPU)) == "detect"
    assert stage_of(take(jobs, WITH_GPU)) == "fit"
    assert stage_of(take(jobs, WITHOUT_GPU, "cpu:1")) == "fit"


def test_gpu_alone_takes_all_in_order_of_queue(jobs: StoreBench) -> None:
    list_worker(jobs, "gpu:1", GPU, (OF_NETWORKS, OF_REST))
    queue_for_ability(jobs, "fit", OF_REST)
    queue_for_ability(jobs, "detect", OF_NETWORKS)
    assert [stage_of(take(jobs, WITH_GPU)) for _ in range(2)] == ["fit", "detect"]


def test_gpu_reserved_leaves_rest_to_others(jobs: StoreBench) -> None:
    reserved = replace(WITH_GPU, reserves_gpu=True)
    list_worker(jobs, "cpu:1", CPU, (OF_REST,))
    queue_for_ability(jobs, "fit", OF_REST, num_chunks=2)
    assert take(jobs, reserved) is None
    # A worker of another version can't run them.
    list_worker(jobs, "cpu:1", CPU, ("c" * 64,))
    assert stage_of(take(jobs, reserved)) == "fit"
    jobs.store.workers.remove(["cpu:1"])
    assert stage_of(take(jobs, reserved)) == "fit"


def test_worker_without_chunk_knows_if_others_could(jobs: StoreBench) -> None:
    queue_for_ability(jobs, "detect", OF_NETWORKS)
    assert not jobs.store.leases.waits_for_others(WITHOUT_GPU)
    list_worker(jobs, "gpu:1", GPU, (OF_NETWORKS, OF_REST))
    assert jobs.store.leases.waits_for_others(WITHOUT_GPU)
    assert not jobs.store.leases.waits_for_others(WITH_GPU)
    assert take(jobs, WITH_GPU) is not None
    assert not jobs.store.leases.waits_for_others(WITHOUT_GPU)


def test_large_chunks_wait_for_workers_with_enough_memory(jobs: StoreBench) -> None:
    small, large = (Ability(frozenset({OF_REST}), memory_bytes=size * MIB) for size in (500, 2000))
    list_worker(jobs, "small:1", CPU, (OF_REST,), 500 * MIB)
    list_worker(jobs, "large:1", CPU, (OF_REST,), 2000 * MIB)
    queue_for_ability(jobs, "fit", OF_REST, 1000 * MIB)
    queue_for_ability(jobs, "check_session", OF_REST, 100 * MIB)
    assert stage_of(take(jobs, small, "small:1")) == "check_session"
    assert stage_of(take(jobs, small, "small:1")) is None
    assert stage_of(take(jobs, large, "large:1")) == "fit"


@pytest.mark.parametrize("gone", ["never there", "away"])
def test_chunk_larger_than_all_workers_is_taken(jobs: StoreBench, gone: str) -> None:
    small = Ability(frozenset({OF_REST}), memory_bytes=500 * MIB)
    list_worker(jobs, "small:1", CPU, (OF_REST,), 500 * MIB)
    if gone == "away":
        list_worker(jobs, "large:1", CPU, (OF_REST,), 2000 * MIB)
        jobs.store.workers.remove(["large:1"])
    queue_for_ability(jobs, "fit", OF_REST, 1000 * MIB)
    assert stage_of(take(jobs, small, "small:1")) == "fit"


def test_machine_runs_chunks_that_fit_its_memory(jobs: StoreBench) -> None:
    on_machine = Ability(frozenset({OF_REST}), machine_bytes=1000 * MIB)
    queue_for_ability(jobs, "fit", OF_REST, 450 * MIB, num_chunks=3)
    held = [take(jobs, on_machine, f"here:{number}") for number in range(2)]
    assert None not in held
    assert take(jobs, on_machine, "here:3") is None
    elsewhere = take(jobs, on_machine, "here.example:3")
    assert elsewhere is not None
    jobs.finish(elsewhere)
    assert jobs.store.jobs.page()[0].state == JobState.RUNNING


def test_chunk_too_large_is_not_overtaken_and_runs_alone(jobs: StoreBench) -> None:
    on_machine = Ability(frozenset({OF_REST}), machine_bytes=1000 * MIB)
    queue_for_ability(jobs, "check_session", OF_REST, 100 * MIB)
    running = take(jobs, on_machine, "here:1")
    assert running is not None
    queue_for_ability(jobs, "fit", OF_REST, 5000 * MIB)
    queue_for_ability(jobs, "check_session", OF_REST, 100 * MIB)
    assert take(jobs, on_machine, "here:2") is None
    jobs.finish(running)
    assert stage_of(take(jobs, on_machine, "here:2")) == "fit"
    assert take(jobs, on_machine, "here:1") is None


def test_workers_list_their_memory(jobs: StoreBench) -> None:
    worker = WorkerStatus("here:1", READY.state, "A worker works", memory_bytes=3 * MIB)
    jobs.store.workers.report(worker)
    assert jobs.store.workers.all() == [worker]


TOO_LONG = JobProblem(TIME_LIMIT, "It took too long.", retryable=True)


def session_of(jobs: StoreBench, tenant: str) -> Session:
    records = jobs.store.tenant(tenant)
    template = jobs.store.sessions.get(jobs.session_id)
    return records.sessions.add("take", template.files, template.preflight, records.sessions.reserve_id())


def queue(jobs: StoreBench, tenant: str, num_chunks: int = 3) -> str:
    session = session_of(jobs, tenant)
    return jobs.store.tenant(tenant).jobs.add(session.id, JobSpec(), stages(num_chunks)).id


def claim(jobs: StoreBench, lease_s: float = LEASE_S) -> Claim | None:
    return jobs.store.leases.claim("worker", lease_s)


def lose(jobs: StoreBench, job_id: str) -> Claim:
    """Claim a chunk, which must be the job's, and lose its worker."""
    lost = jobs.claim(EXPIRED_S)
    assert lost.job_id == job_id
    jobs.store.leases.reap(LEASE_S)
    return lost


def pass_time(jobs: StoreBench, seconds: float) -> None:
    """Let retries be due earlier."""
    jobs.execute(sa.update(chunks).values(due_at=chunks.c.due_at - seconds))


def wait_s(jobs: StoreBench) -> float:
    """Time until the only lost chunk is due."""
    engine = sa.create_engine(jobs.url)
    with engine.connect() as connection:
        seconds: float = connection.execute(
            sa.select(sa.cast(chunks.c.due_at, sa.Double) - now()).where(chunks.c.lost_tries > 0)
        ).scalar_one()
    engine.dispose()
    return seconds


def test_retries_after_lost_leases_wait_longer_each_time(jobs: StoreBench) -> None:
    job_id = queue(jobs, "one", num_chunks=1)
    lose(jobs, job_id)
    assert wait_s(jobs) <= 0.0  # the first loss may be an outage's fault
    for expected_s in (20.0, 60.0, 180.0):
        lose(jobs, job_id)
        assert wait_s(jobs) == pytest.approx(expected_s, abs=5.0)
        assert claim(jobs) is None
        assert not jobs.store.leases.reap(LEASE_S)  # no worker is woken for it
        pass_time(jobs, 200.0)
        assert jobs.store.leases.reap(LEASE_S)
    lose(jobs, job_id)
    job = jobs.store.jobs.get(job_id)
    assert job.state == JobState.FAILED
    assert job.problem is not None
    assert job.problem.code == "worker_lost"


def test_retry_comes_after_first_tries_of_all_tenants(jobs: StoreBench) -> None:
    lost_job = queue(jobs, "one", num_chunks=2)
    lost = lose(jobs, lost_job)
    own, other = queue(jobs, "one", num_chunks=1), queue(jobs, "two", num_chunks=1)
    order = [jobs.claim() for _ in range(3)]
    assert {work.job_id for work in order[:2]} == {own, other}
    assert (order[2].job_id, order[2].index, order[2].attempt) == (lost_job, lost.index, 2)
    # The other chunk of its job might cost a worker too.
    last = jobs.claim()
    assert (last.job_id, last.index, last.attempt) == (lost_job, 1, 1)


def test_retry_overdue_has_its_turn(jobs: StoreBench) -> None:
    lost_job = queue(jobs, "one", num_chunks=1)
    lose(jobs, lost_job)
    for _ in range(20):
        queue(jobs, "two", num_chunks=1)
    for seconds in (0.0, 15.0):
        pass_time(jobs, seconds)
        first = jobs.claim()
        assert first.job_id != lost_job
        jobs.finish(first)
    pass_time(jobs, 20.0)
    assert lost_job in {jobs.claim().job_id for _ in range(2)}


def test_tenant_has_at_most_two_running_retries(jobs: StoreBench) -> None:
    for _ in range(5):
        queue(jobs, "one", num_chunks=1)
    for _ in range(5):
        jobs.claim(EXPIRED_S)
    jobs.store.leases.reap(LEASE_S)
    retries = list(iter(partial(claim, jobs), None))
    assert [work.attempt for work in retries] == [2, 2]
    jobs.finish(retries[0])
    # The next retry, and the last chunk of the job whose retry is done.
    assert [(work.stage, work.attempt) for work in iter(partial(claim, jobs), None)] == [("detect", 2), ("export", 1)]


def lose_often(jobs: StoreBench, num_jobs: int) -> list[Claim]:
    """Lose a chunk of each of some jobs of the tenant ``one``; the first one has lost two tries then, long ago."""
    for _ in range(num_jobs):
        queue(jobs, "one", num_chunks=1)
    lost = [jobs.claim(EXPIRED_S) for _ in range(num_jobs)]
    jobs.store.leases.reap(LEASE_S)
    jobs.execute(sa.update(chunks).where(chunks.c.id == lost[0].chunk_id).values(lost_tries=2))
    pass_time(jobs, 1000.0)
    return lost


def test_tenant_beside_others_has_one_running_retry(jobs: StoreBench) -> None:
    lose_often(jobs, 3)
    other = queue(jobs, "two", num_chunks=1)
    held = [jobs.claim() for _ in range(2)]
    assert {work.job_id == other for work in held} == {True, False}
    assert claim(jobs) is None
    # A retry that has run for long is under no suspicion.
    (retry,) = [work for work in held if work.job_id != other]
    jobs.execute(sa.update(chunks).where(chunks.c.id == retry.chunk_id).values(claimed_at=now() - 60.0))
    assert jobs.claim().attempt == 2
    assert claim(jobs) is None  # no more than two


def test_tenant_beside_others_waits_for_last_lost_chunk(jobs: StoreBench) -> None:
    lost = lose_often(jobs, 2)
    fresh, other = queue(jobs, "one", num_chunks=1), queue(jobs, "two", num_chunks=4)
    jobs.execute(sa.update(chunks).where(chunks.c.id == lost[0].chunk_id).values(due_at=now() + 100.0))
    assert [jobs.claim().job_id for _ in range(4)] == [other] * 4  # neither the other retry nor a first try
    assert claim(jobs) is None
    pass_time(jobs, 200.0)
    retry = jobs.claim()
    assert retry.chunk_id == lost[0].chunk_id
    assert claim(jobs) is None
    jobs.finish(retry)
    # With one lost chunk left, its other jobs are no longer under suspicion.
    assert fresh in {jobs.claim().job_id for _ in range(3)}


def test_chunk_with_two_lost_tries_takes_no_idle_worker(jobs: StoreBench) -> None:
    job_id = queue(jobs, "one", num_chunks=1)
    for _ in range(2):
        lose(jobs, job_id)
    other = queue(jobs, "two", num_chunks=1)
    held = jobs.claim()
    assert held.job_id == other
    pass_time(jobs, 50.0)  # due for 30 s
    assert claim(jobs) is None
    pass_time(jobs, 40.0)
    assert jobs.claim().job_id == job_id


def test_jobs_after_lost_chunk_take_no_idle_worker(jobs: StoreBench) -> None:
    lose_often(jobs, 2)
    jobs.execute(sa.update(chunks).where(chunks.c.lost_tries > 0).values(due_at=now() - 30.0))
    fresh, other = queue(jobs, "one", num_chunks=1), queue(jobs, "two", num_chunks=1)
    held = [jobs.claim() for _ in range(2)]
    assert {work.job_id for work in held} >= {other}
    assert fresh not in {work.job_id for work in held}
    assert claim(jobs) is None
    for work in held:
        jobs.finish(work)


def test_tenant_alone_waits_for_no_other_chunk(jobs: StoreBench) -> None:
    for _ in range(2):
        queue(jobs, "one", num_chunks=1)
    lost = [jobs.claim(EXPIRED_S) for _ in range(2)]
    fresh = queue(jobs, "one", num_chunks=1)
    jobs.store.leases.reap(LEASE_S)
    jobs.execute(sa.update(chunks).where(chunks.c.id == lost[1].chunk_id).values(due_at=now() + 100.0))
    assert [jobs.claim().chunk_id, jobs.claim().job_id] == [lost[0].chunk_id, fresh]


def test_chunks_of_job_wait_for_chunk_with_two_lost_tries(jobs: StoreBench) -> None:
    job_id = queue(jobs, "one", num_chunks=3)
    lost = lose(jobs, job_id)
    assert lose(jobs, job_id).chunk_id == lost.chunk_id
    assert claim(jobs) is None  # the two others might cost a worker each
    pass_time(jobs, 30.0)
    jobs.finish(jobs.claim())
    jobs.finish_all()
    assert jobs.store.jobs.get(job_id).state == JobState.SUCCEEDED


def test_chunks_lost_in_outage_run_again_at_once(jobs: StoreBench) -> None:
    job_id = queue(jobs, "one", num_chunks=6)
    held = [jobs.claim(EXPIRED_S if number < 3 else LEASE_S) for number in range(4)]
    jobs.store.leases.reap(LEASE_S)
    again = list(iter(partial(claim, jobs), None))
    # Two of the lost chunks, and the chunks that no worker has begun yet.
    assert [(work.index, work.attempt) for work in again] == [(0, 2), (1, 2), (4, 1), (5, 1)]
    for work in (*again, held[3]):
        jobs.finish(work)
    jobs.finish_all()
    assert jobs.store.jobs.get(job_id).state == JobState.SUCCEEDED


def test_turns_of_tenants_survive_process_that_claims(jobs: StoreBench) -> None:
    for tenant in ("one", "two", "three"):
        queue(jobs, tenant, num_chunks=12)
    owners = []
    for _ in range(12):
        store = JobStore(jobs.url)  # each claim in a process of its own
        work = store.leases.claim("worker", LEASE_S)
        store.close()
        assert work is not None
        owners.append(work.job_id)
        jobs.finish(work)
    assert [len(set(owners[k : k + 3])) for k in range(0, 12, 3)] == [3] * 4


def test_chunk_too_long_has_two_tries(jobs: StoreBench) -> None:
    job_id = queue(jobs, "one", num_chunks=1)
    first = jobs.claim()
    assert jobs.store.leases.fail(first.chunk_id, first.lease_token, TOO_LONG)
    other = queue(jobs, "two", num_chunks=1)
    assert jobs.claim().job_id == other
    again = jobs.claim()
    assert (again.job_id, again.attempt) == (job_id, 2)
    assert not jobs.store.leases.fail(again.chunk_id, again.lease_token, TOO_LONG)
    job = jobs.store.jobs.get(job_id)
    assert job.state == JobState.FAILED
    assert job.problem is not None
    assert job.problem.detail == "It took too long. It was the last of 2 tries."


def test_chunk_done_after_lost_try_is_no_longer_behind(jobs: StoreBench) -> None:
    job_id = queue(jobs, "one", num_chunks=2)
    lose(jobs, job_id)
    jobs.finish(jobs.claim())
    other = queue(jobs, "two", num_chunks=1)
    assert {jobs.claim().job_id, jobs.claim().job_id} == {job_id, other}
    engine = sa.create_engine(jobs.url)
    with engine.connect() as connection:
        lost = connection.execute(sa.select(chunks.c.id).where(chunks.c.lost_tries > 0)).all()
        done = connection.execute(sa.select(chunks.c.id).where(chunks.c.state == ChunkState.DONE)).all()
    engine.dispose()
    assert (len(lost), len(done)) == (0, 1)
