"""Blurred videos of jobs: made once with the job, and left by edits of people and by visuals that are made anew."""

from functools import partial

from pipeline.core.options.edits import Remove
from pipeline.run.engine.stage import BLUR, DETECT, HEADS
from tests.worker.conftest import RESULT, RunnerBench
from worker.run.planning import plan_remake
from worker.store.model.job_records import JobRecord
from worker.store.model.states import JobState
from worker.store.repositories.work.expiry import remove_files
from worker.store.spec import FilesAdded, JobSpec

SPEC = JobSpec(blur_faces=True, overlay=True)
VIDEO = b"blurred by heads in " + RESULT


def done(bench: RunnerBench, spec: JobSpec = SPEC) -> JobRecord:
    job = bench.create_job(spec=spec)
    bench.runner().work(60.0)
    job = bench.store.jobs.get(job.id)
    assert job.state is JobState.SUCCEEDED
    return job


def stage_names(job: JobRecord) -> set[str]:
    return {stage.name for stage in job.stages}


def listed(bench: RunnerBench, job_id: str) -> dict[str, int]:
    return {result.name: result.revision for result in bench.store.results.downloads(job_id)}


def test_job_that_blurs_has_blurred_video_of_each_camera(bench: RunnerBench) -> None:
    job = done(bench)
    assert {HEADS, BLUR} <= stage_names(job)
    assert bench.result(job.id, "blurred-0.mp4") == VIDEO
    assert not {HEADS, BLUR} & stage_names(done(bench, JobSpec(overlay=True)))


def test_blurring_detects_nothing_again(bench: RunnerBench) -> None:
    """The heads are found in what the session has; the outputs of the earlier job are used."""
    done(bench, JobSpec())
    job = done(bench)
    assert [stage.name for stage in job.stages if stage.name == DETECT and not stage.reused] == []


def test_edits_and_visuals_leave_blurred_videos(bench: RunnerBench) -> None:
    job = done(bench)
    bench.edit(job.id, Remove(person=1))
    bench.runner().work(60.0)
    edited = bench.store.jobs.get(job.id)
    assert (edited.state, BLUR in stage_names(edited)) == (JobState.SUCCEEDED, False)
    before = listed(bench, job.id)
    assert (before["person-1.bvh"], before["blurred-0.mp4"], before["overlay-left.mp4"]) == (1, 0, 0)
    visuals = bench.make_visuals(job.id)
    assert (HEADS in stage_names(visuals), BLUR in stage_names(visuals)) == (True, False)
    bench.runner().work(60.0)
    remove_files(bench.store.removals, bench.artifacts)
    after = listed(bench, job.id)
    assert (after["blurred-0.mp4"], after["overlay-left.mp4"]) == (0, 1)
    assert bench.result(job.id, "blurred-0.mp4") == VIDEO


def test_blurred_videos_are_added_to_finished_job(bench: RunnerBench) -> None:
    job = done(bench, JobSpec(report=True))
    added = FilesAdded(blur_faces=True)
    bench.store.jobs.remake(job.id, partial(plan_remake, bench.session), added)
    bench.runner().work(60.0)
    remade = bench.store.jobs.get(job.id)
    assert ({BLUR, DETECT} & stage_names(remade), remade.has_old_visuals) == ({DETECT}, True)
    assert [stage.name for stage in remade.stages if stage.name == DETECT and stage.reused] == []  # it stayed done
    assert bench.store.visuals.due(3600.0) == [job.id]
    visuals = bench.make_visuals(job.id)
    bench.runner().work(60.0)
    assert BLUR in stage_names(visuals)
    assert bench.result(job.id, "blurred-0.mp4") == VIDEO
    assert listed(bench, job.id)["report.html"] == 1  # without faces
    # They are made once.
    bench.edit(job.id, Remove(person=1))
    bench.runner().work(60.0)
    assert BLUR not in stage_names(bench.make_visuals(job.id))


def test_expired_and_deleted_jobs_leave_no_blurred_video(bench: RunnerBench) -> None:
    job = done(bench)
    assert bench.store.sessions.capture(bench.session.id).blurred >= {"blurred-0.mp4"}
    bench.store.jobs.delete(job.id)
    remove_files(bench.store.removals, bench.artifacts)
    capture = bench.store.sessions.capture(bench.session.id)
    assert (capture.is_blurred, capture.blurred) == (False, frozenset())
    assert not list((bench.data_dir / "artifacts" / "jobs").rglob("blurred-*"))
