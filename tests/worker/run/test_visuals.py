"""Visuals of edited jobs: made behind the edits, by a job of their own, without work done twice."""

from collections.abc import Callable

import pytest

from pipeline.core.options.edits import PeopleEdit, Remove
from pipeline.run.engine.stage import DETECT, EXPORT, OVERLAY, RECORD, REPORT, WRITE, Output
from tests.worker.conftest import RESULT, RunnerBench
from worker.run.chunk import Work
from worker.run.planning import plan_again, plan_visuals
from worker.run.reaper import Reaper
from worker.store.errors import Conflict, NotFound
from worker.store.files.disk import DiskSpace
from worker.store.model.job_records import JobRecord
from worker.store.model.states import JobState
from worker.store.repositories.work.expiry import remove_files
from worker.store.spec import JobSpec

FIRST, SECOND = Remove(person=1), Remove(person=2)
SPEC = JobSpec(overlay=True, report=True)
VIDEO, PAGE = "overlay-left.mp4", "report.html"


@pytest.fixture
def done(bench: RunnerBench) -> JobRecord:
    job = bench.create_job(spec=SPEC)
    bench.runner().work(60.0)
    return bench.store.jobs.get(job.id)


@pytest.fixture
def run(bench: RunnerBench) -> list[str]:
    """Stages that were run, not reused."""
    stages: list[str] = []

    def noted(function: Callable[[Work], Output]) -> Callable[[Work], Output]:
        def run_noted(work: Work) -> Output:
            stages.append(work.claim.stage)
            return function(work)

        return run_noted

    bench.stages |= {name: noted(function) for name, function in bench.stages.items()}
    return stages


def edited(bench: RunnerBench, job_id: str, *edits: PeopleEdit) -> JobRecord:
    """Edit a job, and make its files."""
    bench.edit(job_id, *edits)
    bench.runner().work(60.0)
    job = bench.store.jobs.get(job_id)
    assert job.state is JobState.SUCCEEDED
    return job


def listed(bench: RunnerBench, job_id: str) -> dict[str, int]:
    """Revisions of the listed files, by name."""
    return {result.name: result.revision for result in bench.store.results.downloads(job_id)}


def shown(*edits: PeopleEdit) -> bytes:
    return RESULT + repr(edits).encode() if edits else RESULT


def test_edits_do_not_wait_for_visuals(bench: RunnerBench, done: JobRecord, run: list[str]) -> None:
    assert listed(bench, done.id) == {"person-1.bvh": 0, VIDEO: 0, PAGE: 0}
    assert not done.has_old_visuals
    job = edited(bench, done.id, FIRST)
    assert not {OVERLAY, REPORT} & set(run)
    assert listed(bench, done.id) == {"person-1.bvh": 1, VIDEO: 0, PAGE: 0}
    assert job.has_old_visuals
    remove_files(bench.store.removals, bench.artifacts)
    assert bench.result(done.id, VIDEO) == b"video of " + RESULT

    visuals = bench.make_visuals(done.id)
    assert bench.make_visuals(done.id).id == visuals.id
    assert bench.store.jobs.get(done.id).visuals_job is not None
    run.clear()
    bench.runner().work(60.0)
    assert run == [OVERLAY, REPORT]
    assert bench.store.jobs.get(visuals.id).state is JobState.SUCCEEDED
    assert listed(bench, done.id) == {"person-1.bvh": 1, VIDEO: 1, PAGE: 1}
    remove_files(bench.store.removals, bench.artifacts)
    assert bench.result(done.id, VIDEO) == b"video of " + shown(FIRST)
    assert bench.result(done.id, PAGE) == b"report of " + shown(FIRST)
    assert bench.result(done.id) == shown(FIRST)
    stored = bench.data_dir / "artifacts" / "jobs" / done.id / "visuals"
    assert {path.relative_to(stored).parts[0] for path in stored.rglob("*") if path.is_file()} == {"1"}
    with pytest.raises(Conflict, match="already"):
        bench.make_visuals(done.id)


def test_visuals_of_undone_edits_equal_unedited_ones(bench: RunnerBench, done: JobRecord, run: list[str]) -> None:
    edited(bench, done.id, FIRST)
    run.clear()
    edited(bench, done.id)
    assert run == [EXPORT]
    bench.make_visuals(done.id)
    bench.runner().work(60.0)
    assert listed(bench, done.id) == {"person-1.bvh": 2, VIDEO: 2, PAGE: 2}
    assert bench.result(done.id, PAGE) == b"report of " + RESULT


@pytest.mark.parametrize("stage", [OVERLAY, REPORT])
def test_newer_edit_deletes_job(bench: RunnerBench, done: JobRecord, stage: str) -> None:
    """A file that is about to be written is not listed, and is removed."""
    edited(bench, done.id, FIRST)
    visuals, function = bench.make_visuals(done.id), bench.stages[stage]

    def edited_meanwhile(work: Work) -> Output:
        output = function(work)
        bench.edit(done.id, SECOND)
        return output

    bench.stages[stage] = edited_meanwhile
    bench.runner().work(60.0)
    with pytest.raises(NotFound):
        bench.store.jobs.get(visuals.id)
    job = bench.store.jobs.get(done.id)
    assert (job.state, job.results_revision, job.has_old_visuals, job.visuals_job) == ("succeeded", 2, True, None)
    revision = 1 if stage == REPORT else 0
    assert listed(bench, done.id) == {"person-1.bvh": 2, VIDEO: revision, PAGE: 0}
    remove_files(bench.store.removals, bench.artifacts)
    assert bench.result(done.id, VIDEO) == b"video of " + (shown(FIRST) if stage == REPORT else RESULT)

    bench.stages[stage] = function
    bench.make_visuals(done.id)
    bench.runner().work(60.0)
    assert listed(bench, done.id) == {"person-1.bvh": 2, VIDEO: 2, PAGE: 2}
    assert bench.result(done.id, VIDEO) == b"video of " + shown(SECOND)


def test_recording_follows_edits_as_report_does(bench: RunnerBench, run: list[str]) -> None:
    job = bench.create_job(spec=JobSpec(exports=("bvh", "rerun")))
    bench.runner().work(60.0)
    assert listed(bench, job.id) == {"person-1.bvh": 0, "take.rrd": 0}
    run.clear()
    edited(bench, job.id, FIRST)
    assert RECORD not in run
    assert listed(bench, job.id) == {"person-1.bvh": 1, "take.rrd": 0}
    bench.make_visuals(job.id)
    run.clear()
    bench.runner().work(60.0)
    assert run == [RECORD]
    assert listed(bench, job.id) == {"person-1.bvh": 1, "take.rrd": 1}
    assert bench.result(job.id, "take.rrd") == b"recording of " + shown(FIRST)


def test_edits_go_before_visuals(bench: RunnerBench, done: JobRecord) -> None:
    other = bench.create_job(spec=SPEC)
    bench.runner().work(60.0)
    edited(bench, done.id, FIRST)
    visuals = bench.make_visuals(done.id)
    bench.edit(other.id, SECOND)
    claims = [bench.store.leases.claim("worker", 30.0) for _ in range(2)]
    assert [claim and claim.job_id for claim in claims] == [other.id, visuals.id]


def test_damaged_outputs_are_computed_again(bench: RunnerBench, done: JobRecord, run: list[str]) -> None:
    edited(bench, done.id, FIRST)
    bench.make_visuals(done.id)
    stages = bench.data_dir / "artifacts" / "sessions" / bench.session.id / "stages"
    for path in stages.iterdir():
        path.write_bytes(b"damaged")
    run.clear()
    bench.runner().work(60.0)
    assert DETECT in run
    assert not {WRITE, EXPORT} & set(run)
    assert bench.result(done.id, VIDEO) == b"video of " + shown(FIRST)


def test_failed_job_can_be_retried_or_asked_for_again(bench: RunnerBench, done: JobRecord) -> None:
    def broken(_: Work) -> Output:
        raise ValueError

    edited(bench, done.id, FIRST)
    function, bench.stages[REPORT] = bench.stages[REPORT], broken
    visuals = bench.make_visuals(done.id)
    bench.runner().work(60.0)
    assert bench.store.jobs.get(visuals.id).state is JobState.FAILED
    assert bench.store.jobs.get(done.id).state is JobState.SUCCEEDED
    again = bench.make_visuals(done.id)
    assert again.id != visuals.id
    bench.runner().work(60.0)
    assert listed(bench, done.id)[PAGE] == 0
    bench.stages[REPORT] = function
    failed = bench.store.jobs.get(again.id)
    bench.store.jobs.retry(again.id, plan_again(bench.session, failed))
    bench.runner().work(60.0)
    remove_files(bench.store.removals, bench.artifacts)
    assert listed(bench, done.id) == {"person-1.bvh": 1, VIDEO: 1, PAGE: 1}
    assert bench.result(done.id, VIDEO) == b"video of " + shown(FIRST)


def test_unneeded_visuals_are_refused(bench: RunnerBench, done: JobRecord) -> None:
    with pytest.raises(Conflict, match="nothing to show"):
        bench.make_visuals(done.id)
    bench.edit(done.id, FIRST)
    with pytest.raises(Conflict, match="files have to be made first"):
        bench.make_visuals(done.id)
    bench.runner().work(60.0)
    job = bench.store.jobs.get(done.id)
    with pytest.raises(Conflict, match="revision 1 now, not 0"):
        bench.store.visuals.add(done.id, *plan_visuals(bench.session, job), 0)
    plain = bench.create_job()
    bench.runner().work(60.0)
    edited(bench, plain.id, FIRST)
    with pytest.raises(Conflict, match="nothing to show"):
        bench.make_visuals(plain.id)


def test_reaper_queues_them_when_edits_rest(bench: RunnerBench, done: JobRecord) -> None:
    def reaped(rest_s: float) -> list[JobRecord]:
        disk = DiskSpace(bench.data_dir, 0)
        Reaper(bench.store, bench.artifacts, disk, lambda: True, 20.0, rest_s).reap()
        return bench.store.jobs.page(kind="visuals")

    assert reaped(1e-9) == []  # nothing was edited
    bench.edit(done.id, FIRST)
    assert reaped(1e-9) == []  # the files of the edit come first
    bench.runner().work(60.0)
    assert reaped(0) == []
    assert reaped(3600.0) == []
    (queued,) = reaped(1e-9)
    assert reaped(1e-9) == [queued]
    assert bench.store.jobs.page() == [bench.store.jobs.get(done.id)]
    bench.runner().work(60.0)
    assert listed(bench, done.id)[PAGE] == 1
    assert [job.id for job in reaped(1e-9)] == [queued.id]


def test_visuals_are_removed_with_their_job_and_count(bench: RunnerBench, done: JobRecord) -> None:
    edited(bench, done.id, FIRST)
    bench.make_visuals(done.id)
    usage = bench.store.tenant("default").usage()
    assert usage.unfinished_jobs == 0
    bench.store.jobs.delete(done.id)
    assert bench.store.jobs.page(kind="visuals") == []
    remove_files(bench.store.removals, bench.artifacts)
    assert not (bench.data_dir / "artifacts" / "jobs" / done.id).exists()
