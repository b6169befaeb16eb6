"""Jobs whose plan no worker can run are planned again, and lose nothing."""

import time

import pytest

from tests.worker.store.conftest import CODE, LEASE_S, StoreBench, stages
from worker.store.model.states import ChunkState, JobState
from worker.store.model.work import Ability, StagePlan, WorkerState, WorkerStatus

OTHER = "d" * 64


def list_worker(jobs: StoreBench, *codes: str, state: WorkerState = WorkerState.READY) -> None:
    jobs.store.workers.report(WorkerStatus("host:1", state, "works", codes=codes))


def of_other_code(num_chunks: int) -> tuple[StagePlan, ...]:
    return tuple(StagePlan(stage.name, stage.chunks, OTHER) for stage in stages(num_chunks))


def test_worker_takes_chunks_of_its_own_code_alone(jobs: StoreBench) -> None:
    jobs.queue(2)
    assert jobs.store.leases.claim("worker", LEASE_S, Ability(frozenset({OTHER}))) is None
    claim = jobs.store.leases.claim("worker", LEASE_S, Ability(frozenset({OTHER, CODE})))
    assert claim is not None


def test_versions_two_work_side_by_side(jobs: StoreBench) -> None:
    old = jobs.queue(1).id
    new = jobs.store.jobs.add(jobs.session_id, jobs.store.jobs.get(old).spec, of_other_code(1)).id
    for code, job_id in ((OTHER, new), (CODE, old)):
        for _ in range(2):
            claim = jobs.store.leases.claim("worker", LEASE_S, Ability(frozenset({code})))
            assert claim is not None
            assert claim.job_id == job_id
            jobs.finish(claim)
        assert jobs.store.jobs.get(job_id).state == JobState.SUCCEEDED


def test_job_without_able_worker_is_found(jobs: StoreBench) -> None:
    job_id = jobs.queue(2).id
    assert jobs.store.plans.unclaimable() == [job_id]
    assert not jobs.store.plans.is_run([OTHER])
    list_worker(jobs, CODE)
    assert jobs.store.plans.unclaimable() == []
    list_worker(jobs, OTHER)
    assert jobs.store.plans.unclaimable() == [job_id]
    assert jobs.store.plans.is_run([OTHER])
    assert not jobs.store.plans.is_run([OTHER, CODE])
    list_worker(jobs, OTHER, state=WorkerState.STARTING)
    assert not jobs.store.plans.is_run([OTHER])


def test_job_with_running_chunks_is_not_planned_again(jobs: StoreBench) -> None:
    job_id = jobs.queue(2).id
    list_worker(jobs, OTHER)
    held = jobs.claim()
    assert jobs.store.plans.unclaimable() == []
    assert not jobs.store.plans.replace(job_id, of_other_code(2))
    jobs.finish(held)
    assert jobs.store.plans.unclaimable() == [job_id]
    assert jobs.store.plans.replace(job_id, of_other_code(2))
    assert jobs.store.plans.unclaimable() == []
    assert jobs.store.jobs.get(job_id).attempt == 1
    jobs.finish_all()
    assert jobs.store.jobs.get(job_id).state == JobState.SUCCEEDED


@pytest.mark.parametrize("end", ["succeeded", "canceled"])
def test_job_ended_is_not_planned_again(jobs: StoreBench, end: str) -> None:
    job_id = jobs.queue(1).id
    if end == "succeeded":
        jobs.finish_all()
    else:
        jobs.store.jobs.cancel(job_id)
    assert jobs.store.plans.unclaimable() == []
    assert not jobs.store.plans.replace(job_id, of_other_code(1))
    assert jobs.store.jobs.get(job_id).state == end


def test_job_canceled_ends_without_able_worker(jobs: StoreBench) -> None:
    job_id = jobs.queue(1).id
    list_worker(jobs, OTHER)
    jobs.claim(lease_s=-1.0)
    jobs.store.jobs.cancel(job_id)
    assert not jobs.store.plans.replace(job_id, of_other_code(1))
    time.sleep(0.01)
    jobs.store.leases.reap(LEASE_S)
    job = jobs.store.jobs.get(job_id)
    assert job.state == JobState.CANCELED
    assert all(stage.state == ChunkState.CANCELED for stage in job.stages)
