"""Damaged and missing outputs: they are computed again, and nothing else is."""

import hashlib
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.run.engine.stage import ASSOCIATE, DETECT, EXPORT, FIT, HOLD, IDENTIFY, Output
from tests.cases import slow_but
from tests.worker.conftest import (
    RESULT,
    RunnerBench,
    associate,
    detect,
    export,
    fit,
    run_side_by_side,
    slow_detect,
)
from worker.run.chunk import Work
from worker.run.planning import plan_job
from worker.store.files.file_keys import stage_key
from worker.store.model.states import JobState
from worker.store.repositories.work.leases import MAX_ATTEMPTS
from worker.store.spec import JobSpec


def stored(bench: RunnerBench, job_id: str, stage: str, chunk: int = 0) -> Path:
    """File of a chunk's output."""
    key = bench.store.outputs.list_stage(job_id, stage)[chunk].key
    return bench.data_dir / "artifacts" / stage_key(bench.session.id, key)


def remove(path: Path) -> None:
    path.unlink()


def flip(path: Path) -> None:
    path.write_bytes(bytes(byte ^ 255 for byte in path.read_bytes()))


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1])


DAMAGES = pytest.mark.parametrize("damage", [flip, truncate, remove])


def test_damaged_output_is_made_again(bench: RunnerBench) -> None:
    bench.create_job()
    bench.runner().work(60.0)
    key = bench.store.outputs.list_stage(bench.store.jobs.page()[0].id, ASSOCIATE)[0].key
    bench.artifacts.put_bytes(stage_key(bench.session.id, key), b"damaged")
    again = bench.create_job()
    bench.runner().work(60.0)
    assert bench.result(again.id) == RESULT
    assert {stage.name: stage.reused for stage in bench.store.jobs.get(again.id).stages}[ASSOCIATE] is False


@DAMAGES
@pytest.mark.parametrize(
    ("stage", "chunk", "reader"),
    slow_but(
        [(DETECT, 2, ASSOCIATE)],
        [(DETECT, 2, ASSOCIATE), (ASSOCIATE, 0, IDENTIFY), (IDENTIFY, 0, FIT), (HOLD, 0, EXPORT)],
    ),
)
def test_output_damaged_before_it_is_read_is_computed_again(
    bench: RunnerBench, stage: str, chunk: int, reader: str, damage: Callable[[Path], None]
) -> None:
    run = bench.stages[reader]
    damages = iter([damage])

    def damaging(work: Work) -> Output:
        for once in damages:
            once(stored(bench, work.claim.job_id, stage, chunk))
        return run(work)

    bench.stages[reader] = damaging
    job = bench.create_job()
    bench.runner().work(60.0)
    assert bench.store.jobs.get(job.id).state is JobState.SUCCEEDED
    assert bench.result(job.id) == RESULT
    (attempt,) = bench.store.jobs.attempts(job.id)
    (failure,) = attempt.failures
    assert (failure.stage, failure.chunk_index, failure.problem.code) == (stage, chunk, "output_damaged")
    assert f"chunk {chunk} of the stage {stage}" in failure.problem.detail


def test_only_damaged_outputs_are_computed_again_all_at_once(bench: RunnerBench) -> None:
    computed: list[int] = []

    def counted(work: Work) -> Output:
        computed.append(work.claim.index)
        return detect(work)

    def damaging(work: Work) -> Output:
        if len(computed) == 4:
            for chunk in (1, 3):
                flip(stored(bench, work.claim.job_id, DETECT, chunk))
        return associate(work)

    bench.stages |= {DETECT: counted, ASSOCIATE: damaging}
    job = bench.create_job()
    bench.runner().work(60.0)
    assert bench.result(job.id) == RESULT
    assert computed == [0, 1, 2, 3, 1, 3]
    assert bench.store.jobs.get(job.id).progress == 1.0


def test_two_damaged_stages_are_computed_again_in_order(bench: RunnerBench) -> None:
    damages = iter([ASSOCIATE, IDENTIFY])

    def damaging(work: Work) -> Output:
        for stage in damages:
            flip(stored(bench, work.claim.job_id, stage))
        return fit(work)

    bench.stages[FIT] = damaging
    job = bench.create_job()
    bench.runner().work(60.0)
    assert bench.result(job.id) == RESULT
    (attempt,) = bench.store.jobs.attempts(job.id)
    assert [failure.stage for failure in attempt.failures] == [IDENTIFY, ASSOCIATE]


def test_disk_that_damages_everything_ends_job(bench: RunnerBench) -> None:
    runs = []

    def damaging(work: Work) -> Output:
        runs.append(work.claim.index)
        flip(stored(bench, work.claim.job_id, DETECT, 1))
        return associate(work)

    bench.stages[ASSOCIATE] = damaging
    job = bench.create_job()
    bench.runner().work(60.0)
    found = bench.store.jobs.get(job.id)
    assert found.state is JobState.FAILED
    assert found.problem is not None
    assert (found.problem.code, found.problem.stage, found.problem.retryable) == ("output_damaged", DETECT, True)
    assert "chunk 1 of the stage detect" in found.problem.detail
    assert "disk" in (found.problem.hint or "")
    assert len(runs) == MAX_ATTEMPTS
    bench.stages[ASSOCIATE] = associate
    bench.store.jobs.retry(job.id, plan_job(bench.session, JobSpec()))
    bench.runner().work(60.0)
    assert bench.result(job.id) == RESULT


def test_workers_side_by_side_compute_damaged_output_again(bench: RunnerBench) -> None:
    damaged = threading.Event()

    def damaging(work: Work) -> Output:
        if not damaged.is_set():
            damaged.set()
            for chunk in range(4):
                flip(stored(bench, work.claim.job_id, DETECT, chunk))
        return associate(work)

    bench.stages |= {DETECT: slow_detect, ASSOCIATE: damaging}
    job = bench.create_job()
    run_side_by_side(bench, 3)
    assert bench.result(job.id) == RESULT


def test_damaged_result_is_rebuilt_by_another_job(bench: RunnerBench) -> None:
    job = bench.create_job()
    bench.runner().work(60.0)
    flip(stored(bench, job.id, HOLD))
    flip(bench.data_dir / "artifacts" / bench.store.results.downloads(job.id)[0].key)
    again = bench.create_job()
    bench.runner().work(60.0)
    assert bench.result(again.id) == RESULT
    reused = {stage.name: stage.reused for stage in bench.store.jobs.get(again.id).stages}
    assert {name for name, is_reused in reused.items() if not is_reused} == {FIT, HOLD, EXPORT}


def test_undamaged_pieces_of_outputs_are_found_by_later_jobs(bench: RunnerBench) -> None:
    found: list[bytes | None] = []

    def export_with_pieces(work: Work) -> Output:
        found.append(work.piece("piece"))
        path = work.scratch / "piece"
        path.write_bytes(b"of a person")
        return replace(export(work), pieces={"piece": path})

    bench.stages[EXPORT] = export_with_pieces
    for damage in (None, None, b"of another person"):
        if damage is not None:
            bench.artifacts.put_bytes(stage_key(bench.session.id, "piece"), damage)
        bench.create_job()
        bench.runner().work(60.0)
    assert found == [None, b"of a person", None]
    assert bench.store.outputs.find(bench.session.id, "piece") == (
        hashlib.sha256(b"of a person").hexdigest(),
        len(b"of a person"),
    )
