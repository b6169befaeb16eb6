"""Workers take the chunks that they can run: by graphics processor and memory, and by the memory of their machine."""

from dataclasses import replace

import pytest

from pipeline.core.options.providers import CPU, Provider
from tests.worker.store.conftest import LEASE_S, StoreBench
from tests.worker.store.repositories.work.test_workers import READY
from worker.store.model.states import JobState
from worker.store.model.work import Ability, ChunkPlan, Claim, StagePlan
from worker.store.spec import JobSpec
from worker.store.worker_status import WorkerStatus

GPU = Provider("cuda", "1.31.1", "NVIDIA H200")
OF_NETWORKS, OF_REST = "a" * 64, "b" * 64
WITH_GPU = Ability(frozenset({OF_NETWORKS, OF_REST}), frozenset({OF_NETWORKS}))
WITHOUT_GPU = Ability(frozenset({OF_REST}))
MIB = 2**20


def queue(jobs: StoreBench, stage: str, code: str, memory_bytes: int = 0, num_chunks: int = 1) -> str:
    chunks = tuple(ChunkPlan(k, {}, 1, f"{stage}-{k}", memory_bytes) for k in range(num_chunks))
    return jobs.store.jobs.add(jobs.session_id, JobSpec(), (StagePlan(stage, chunks, code),)).id


def list_worker(jobs: StoreBench, name: str, provider: Provider, codes: tuple[str, ...], memory_bytes: int = 0) -> None:
    worker = replace(READY, id=name, provider=provider, codes=codes, memory_bytes=memory_bytes)
    jobs.store.workers.report(worker)


def take(jobs: StoreBench, ability: Ability, worker: str = "gpu:1") -> Claim | None:
    return jobs.store.leases.claim(worker, LEASE_S, ability)


def stage_of(claim: Claim | None) -> str | None:
    return None if claim is None else claim.stage


def test_a_gpu_takes_networks_first_while_others_do_the_rest(jobs: StoreBench) -> None:
    list_worker(jobs, "gpu:1", GPU, (OF_NETWORKS, OF_REST))
    list_worker(jobs, "cpu:1", CPU, (OF_REST,))
    queue(jobs, "fit", OF_REST, num_chunks=2)
    queue(jobs, "detect", OF_NETWORKS)
    assert stage_of(take(jobs, WITH_GPU)) == "detect"
    assert stage_of(take(jobs, WITH_GPU)) == "fit"
    assert stage_of(take(jobs, WITHOUT_GPU, "cpu:1")) == "fit"


def test_a_gpu_alone_takes_everything_in_the_order_of_the_queue(jobs: StoreBench) -> None:
    list_worker(jobs, "gpu:1", GPU, (OF_NETWORKS, OF_REST))
    queue(jobs, "fit", OF_REST)
    queue(jobs, "detect", OF_NETWORKS)
    assert [stage_of(take(jobs, WITH_GPU)) for _ in range(2)] == ["fit", "detect"]


def test_a_reserved_gpu_leaves_the_rest_to_others_as_long_as_there_are_any(jobs: StoreBench) -> None:
    reserved = replace(WITH_GPU, reserves_gpu=True)
    list_worker(jobs, "cpu:1", CPU, (OF_REST,))
    queue(jobs, "fit", OF_REST, num_chunks=2)
    assert take(jobs, reserved) is None
    # A worker of another version can't run them.
    list_worker(jobs, "cpu:1", CPU, ("c" * 64,))
    assert stage_of(take(jobs, reserved)) == "fit"
    jobs.store.workers.remove(["cpu:1"])
    assert stage_of(take(jobs, reserved)) == "fit"


def test_a_worker_that_finds_nothing_knows_whether_another_one_could(jobs: StoreBench) -> None:
    queue(jobs, "detect", OF_NETWORKS)
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
    queue(jobs, "fit", OF_REST, 1000 * MIB)
    queue(jobs, "check_session", OF_REST, 100 * MIB)
    assert stage_of(take(jobs, small, "small:1")) == "check_session"
    assert stage_of(take(jobs, small, "small:1")) is None
    assert stage_of(take(jobs, large, "large:1")) == "fit"


@pytest.mark.parametrize("gone", ["never there", "away"])
def test_no_chunk_waits_for_memory_that_no_worker_has(jobs: StoreBench, gone: str) -> None:
    small = Ability(frozenset({OF_REST}), memory_bytes=500 * MIB)
    list_worker(jobs, "small:1", CPU, (OF_REST,), 500 * MIB)
    if gone == "away":
        list_worker(jobs, "large:1", CPU, (OF_REST,), 2000 * MIB)
        jobs.store.workers.remove(["large:1"])
    queue(jobs, "fit", OF_REST, 1000 * MIB)
    assert stage_of(take(jobs, small, "small:1")) == "fit"


def test_a_machine_runs_as_many_chunks_at_once_as_fit_into_its_memory(jobs: StoreBench) -> None:
    on_machine = Ability(frozenset({OF_REST}), machine_bytes=1000 * MIB)
    queue(jobs, "fit", OF_REST, 450 * MIB, num_chunks=3)
    held = [take(jobs, on_machine, f"here:{number}") for number in range(2)]
    assert None not in held
    assert take(jobs, on_machine, "here:3") is None
    elsewhere = take(jobs, on_machine, "here.example:3")
    assert elsewhere is not None
    jobs.finish(elsewhere)
    assert jobs.store.jobs.page()[0].state == JobState.RUNNING


def test_a_large_chunk_is_not_overtaken_and_runs_alone_when_the_others_are_done(jobs: StoreBench) -> None:
    on_machine = Ability(frozenset({OF_REST}), machine_bytes=1000 * MIB)
    queue(jobs, "check_session", OF_REST, 100 * MIB)
    running = take(jobs, on_machine, "here:1")
    assert running is not None
    queue(jobs, "fit", OF_REST, 5000 * MIB)
    queue(jobs, "check_session", OF_REST, 100 * MIB)
    assert take(jobs, on_machine, "here:2") is None
    jobs.finish(running)
    assert stage_of(take(jobs, on_machine, "here:2")) == "fit"
    assert take(jobs, on_machine, "here:1") is None


def test_workers_list_their_memory(jobs: StoreBench) -> None:
    worker = WorkerStatus("here:1", READY.state, "A worker works", memory_bytes=3 * MIB)
    jobs.store.workers.report(worker)
    assert jobs.store.workers.all() == [worker]
