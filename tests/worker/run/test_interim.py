"""Interim outputs: they pass from stage to stage of one job, and go when it ends."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.run.engine.stage import DETECT, EXPORT, FIT, IDENTIFY, Output
from tests.cases import slow_but
from tests.worker.conftest import RESULT, RunnerBench, detect, fit, identify
from worker.run.chunk import StoppedError, Work
from worker.run.planning import plan_job
from worker.store.backup.create import create_backup
from worker.store.model.job_records import JobRecord
from worker.store.model.states import JobState
from worker.store.repositories.work.expiry import remove_files
from worker.store.spec import JobSpec

NUM_CHUNKS = 4


class Stages:
    """Stages that pass interim outputs on: those of detection come from its output, so both ways give the same.

    ``detected`` and ``measured`` are the indices of the chunks that were run with and without the network.
    """

    def __init__(self, bench: RunnerBench) -> None:
        self.bench = bench
        self.detected: list[int] = []
        self.measured: list[int] = []
        self.passed: list[list[bytes]] = []
        bench.stages |= {DETECT: self.detect, IDENTIFY: self.identify}

    def detect(self, work: Work) -> Output:
        (self.detected if work.found is None else self.measured).append(work.claim.index)
        content = detect(work).content if work.found is None else work.found
        assert isinstance(content, bytes)
        return Output(content, interim=b"colours of " + content)

    def identify(self, work: Work) -> Output:
        self.passed.append(work.interim(DETECT))
        assert self.passed[-1] == [b"colours of " + content for content in work.outputs(DETECT)]
        return identify(work)

    def forget(self) -> None:
        self.detected, self.measured, self.passed = [], [], []


@pytest.fixture
def stages(bench: RunnerBench) -> Stages:
    return Stages(bench)


def run(bench: RunnerBench, **choices: object) -> JobRecord:
    """Run a job with some choices to its end."""
    spec = JobSpec.model_validate(choices)
    job = bench.store.jobs.add(bench.session.id, spec, plan_job(bench.session, spec))
    bench.runner().work(60.0)
    return bench.store.jobs.get(job.id)


def left(bench: RunnerBench) -> list[Path]:
    """Files with interim outputs, in the data folder or anywhere below it."""
    return [path for path in bench.data_dir.rglob("*") if path.is_file() and b"colours of" in path.read_bytes()]


def test_first_people_are_stored_until_end(bench: RunnerBench) -> None:
    """The last chunk of a range sees the outputs of the others, and leaves people to be looked at."""
    seen: list[list[bytes | None]] = []

    def detect_and_show(work: Work) -> Output:
        seen.append(work.finished(DETECT, slice(0, NUM_CHUNKS)))
        return replace(detect(work), first_people=b"people to see")

    def identify_after(work: Work) -> Output:
        assert len([path for path in bench.data_dir.rglob("*.people") if path.read_bytes() == b"people to see"]) > 0
        return identify(work)

    bench.stages |= {DETECT: detect_and_show, IDENTIFY: identify_after}
    assert run(bench).state is JobState.SUCCEEDED
    assert [sum(content is not None for content in contents) for contents in seen] == list(range(NUM_CHUNKS))
    remove_files(bench.store.removals, bench.artifacts)
    assert list(bench.data_dir.rglob("*.people")) == []


def test_interim_outputs_reach_next_stage_until_end(bench: RunnerBench, stages: Stages) -> None:
    job = run(bench)
    assert bench.result(job.id) == RESULT
    assert (stages.detected, stages.measured, len(stages.passed)) == ([0, 1, 2, 3], [], 1)
    assert len(left(bench)) == NUM_CHUNKS
    remove_files(bench.store.removals, bench.artifacts)
    assert left(bench) == []


def test_job_that_needs_no_association_needs_none(bench: RunnerBench, stages: Stages) -> None:
    run(bench)
    remove_files(bench.store.removals, bench.artifacts)
    stages.forget()
    job = run(bench, smoothing="none")
    assert job.state is JobState.SUCCEEDED
    assert (stages.detected, stages.measured, stages.passed) == ([], [], [])
    assert {stage.name: stage.reused for stage in job.stages}[DETECT]


@pytest.mark.parametrize("is_removed", slow_but([True], [True, False]))
def test_another_association_makes_them_again_from_detections(
    bench: RunnerBench, stages: Stages, is_removed: bool
) -> None:
    run(bench)
    if is_removed:
        remove_files(bench.store.removals, bench.artifacts)
    before = stages.passed[0]
    stages.forget()
    job = run(bench, people=1)
    assert job.state is JobState.SUCCEEDED
    assert (stages.detected, stages.measured, stages.passed) == ([], [0, 1, 2, 3], [before])
    remove_files(bench.store.removals, bench.artifacts)
    assert left(bench) == []


def test_stage_that_always_runs_gets_them_again(
    bench: RunnerBench, stages: Stages, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("worker.run.runner.interim_readers", lambda stage: (EXPORT,) if stage == DETECT else ())
    run(bench)
    remove_files(bench.store.removals, bench.artifacts)
    stages.forget()
    job = run(bench)
    assert job.state is JobState.SUCCEEDED
    assert (stages.detected, stages.measured, stages.passed) == ([], [0, 1, 2, 3], [])


@pytest.mark.slow
def test_without_colours_there_are_none(bench: RunnerBench, stages: Stages) -> None:
    run(bench, appearance="off")
    stages.forget()
    bench.stages[IDENTIFY] = identify
    job = run(bench, appearance="off", people=1)
    assert {stage.name: stage.reused for stage in job.stages}[DETECT]
    assert stages.measured == []


def flip(path: Path) -> None:
    path.write_bytes(bytes(byte ^ 1 for byte in path.read_bytes()))


@pytest.mark.parametrize("damage", slow_but([flip], [flip, Path.unlink]))
def test_damaged_one_is_made_again(bench: RunnerBench, stages: Stages, damage: Callable[[Path], None]) -> None:
    damages = iter([damage])

    def damaging(work: Work) -> Output:
        for once in damages:
            once(sorted(left(bench))[0])
        return stages.identify(work)

    bench.stages[IDENTIFY] = damaging
    job = run(bench)
    assert bench.result(job.id) == RESULT
    assert (len(stages.detected), len(stages.measured)) == (NUM_CHUNKS, 1)
    (attempt,) = bench.store.jobs.attempts(job.id)
    assert [failure.problem.code for failure in attempt.failures] == ["output_damaged"]


@pytest.mark.parametrize("damage", slow_but([flip], [flip, Path.unlink]))
@pytest.mark.parametrize("is_interim", [False, True])
def test_damaged_one_that_is_copied_is_made_again(
    bench: RunnerBench, stages: Stages, is_interim: bool, damage: Callable[[Path], None]
) -> None:
    damages = iter([damage])

    def detect_to_file(work: Work) -> Output:
        output, path = stages.detect(work), work.scratch / "colours"
        assert isinstance(output.interim, bytes)
        path.write_bytes(output.interim)
        return replace(output, interim=path)

    def damaging(work: Work) -> Output:
        read = work.interim if is_interim else work.outputs
        for once in damages:
            (content,) = read(DETECT, slice(1))
            files = (path for path in bench.data_dir.rglob("*") if path.is_file())
            once(
                min(
                    (path for path in files if path.read_bytes().endswith(content)),
                    key=lambda path: path.stat().st_size,
                )
            )
        copy = work.scratch / "copy"
        work.copy_output(DETECT, 0, copy, is_interim)
        assert [copy.read_bytes()] == read(DETECT, slice(1))
        return stages.identify(work)

    bench.stages |= {DETECT: detect_to_file, IDENTIFY: damaging}
    job = run(bench)
    assert bench.result(job.id) == RESULT
    made_again = (NUM_CHUNKS, 1) if is_interim else (NUM_CHUNKS + 1, 0)
    assert (len(stages.detected), len(stages.measured)) == made_again
    (attempt,) = bench.store.jobs.attempts(job.id)
    assert [failure.problem.code for failure in attempt.failures] == ["output_damaged"]


@pytest.mark.slow
def test_interim_outputs_of_failed_job_are_made_again(bench: RunnerBench, stages: Stages) -> None:
    def broken(work: Work) -> Output:
        raise RuntimeError

    bench.stages[IDENTIFY] = broken
    job = run(bench)
    assert job.state is JobState.FAILED
    bench.stages[IDENTIFY] = stages.identify
    stages.forget()
    bench.store.jobs.retry(job.id, plan_job(bench.session, job.spec))
    remove_files(bench.store.removals, bench.artifacts)
    assert left(bench) == []
    bench.runner().work(60.0)
    assert bench.result(job.id) == RESULT
    assert (stages.detected, stages.measured) == ([], [0, 1, 2, 3])
    remove_files(bench.store.removals, bench.artifacts)
    assert left(bench) == []


@pytest.mark.slow
def test_removal_that_is_late_takes_nothing_from_next_attempt(bench: RunnerBench, stages: Stages) -> None:
    def broken(work: Work) -> Output:
        raise RuntimeError

    def late(work: Work) -> Output:
        remove_files(bench.store.removals, bench.artifacts)
        return stages.identify(work)

    bench.stages[IDENTIFY] = broken
    job = run(bench)
    bench.stages[IDENTIFY] = late
    bench.store.jobs.retry(job.id, plan_job(bench.session, job.spec))
    bench.runner().work(60.0)
    assert bench.result(job.id) == RESULT
    *_, attempt = bench.store.jobs.attempts(job.id)
    assert attempt.failures == ()


@pytest.mark.slow
def test_interim_outputs_of_canceled_job_are_removed(bench: RunnerBench, stages: Stages) -> None:
    def canceling(work: Work) -> Output:
        bench.store.jobs.cancel(work.claim.job_id)
        raise StoppedError

    bench.stages[IDENTIFY] = canceling
    job = run(bench)
    assert job.state is JobState.CANCELED
    assert len(left(bench)) == NUM_CHUNKS
    remove_files(bench.store.removals, bench.artifacts)
    assert left(bench) == []


def test_backup_holds_none(bench: RunnerBench, stages: Stages, tmp_path: Path) -> None:
    archive = tmp_path / "there" / "backup.tar"
    archive.parent.mkdir()

    def backing_up(work: Work) -> Output:
        assert len(left(bench)) == NUM_CHUNKS
        create_backup(
            bench.data_dir, f"sqlite:///{bench.data_dir / 'multicap.db'}", "", archive, lambda done, total: None
        )
        return fit(work)

    bench.stages[FIT] = backing_up
    run(bench)
    content = archive.read_bytes()
    assert b"0,1,4,9" in content  # detections
    assert b"colours of" not in content
