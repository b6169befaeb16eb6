"""Sessions whose videos are deleted: what goes, what stays, and what goes on without them."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.core.errors import InputError
from pipeline.core.options.edits import Remove
from pipeline.run.engine.plan import STAGES
from pipeline.run.engine.stage import BLUR, DETECT, LOOK, OVERLAY, PROXY, RECORD, REDETECT, Output
from tests.worker.conftest import RESULT, RunnerBench, fail_with
from worker.run.chunk import Work
from worker.run.execution import KeptSession
from worker.run.planning import plan_again
from worker.run.reaper import Reaper
from worker.store.backup.contents import named_files
from worker.store.errors import Conflict, NotFound, VideosDeleted
from worker.store.files.disk import DiskSpace
from worker.store.files.file_keys import thumbnail_key
from worker.store.model.job_records import JobRecord
from worker.store.model.states import FilesState, JobState
from worker.store.spec import JobSpec

ONCE = JobSpec(keep_videos=False)
FIRST = (Remove(person=1),)


@pytest.fixture
def filled(bench: RunnerBench) -> RunnerBench:
    """Session whose files are stored."""
    for file in bench.session.files:
        bench.artifacts.put_bytes(file.key, b"x")
    bench.artifacts.put_bytes(thumbnail_key(bench.session.id, "0-0.jpg"), b"x")
    return bench


def reaper(bench: RunnerBench) -> Reaper:
    return Reaper(bench.store, bench.artifacts, DiskSpace(bench.data_dir, 0), lambda: True, 20.0, 0.001)


def inputs(bench: RunnerBench) -> list[str]:
    """Names of the session's files and pictures that are on the disk."""
    folder = bench.data_dir / "artifacts" / "sessions" / bench.session.id
    return sorted(path.name for part in ("inputs", "thumbnails") for path in (folder / part).rglob("*"))


def is_deleted(bench: RunnerBench) -> bool:
    return bench.store.sessions.get(bench.session.id).videos_deleted_at is not None


def done(bench: RunnerBench, spec: JobSpec = ONCE) -> JobRecord:
    job = bench.create_job(spec=spec)
    bench.runner().work(60.0)
    job = bench.store.jobs.get(job.id)
    assert job.state is JobState.SUCCEEDED
    return job


def test_videos_go_once_their_job_has_succeeded(filled: RunnerBench) -> None:
    assert inputs(filled) == ["0-0.jpg", "left.mp4", "rig.toml"]
    filled.create_job(spec=ONCE)
    reaper(filled).reap()
    assert not is_deleted(filled)
    filled.runner().work(60.0)
    reaper(filled).reap()
    assert is_deleted(filled)
    assert inputs(filled) == ["rig.toml"]
    session = filled.store.sessions.get(filled.session.id)
    # Digests stay: keys of stages are made of them.
    assert [file.name for file in session.files] == ["left.mp4", "rig.toml"]
    assert [file.name for file in session.stored_files] == ["rig.toml"]


def test_videos_stay_without_choice(filled: RunnerBench) -> None:
    done(filled, JobSpec())
    reaper(filled).reap()
    assert inputs(filled) == ["0-0.jpg", "left.mp4", "rig.toml"]


def test_other_jobs_keep_them_until_their_end(filled: RunnerBench) -> None:
    first = filled.create_job(spec=ONCE)
    other = filled.create_job(spec=JobSpec(profile="fast"))
    while filled.store.jobs.get(first.id).state is not JobState.SUCCEEDED:
        claim = filled.store.leases.claim("worker", 30.0)
        assert claim is not None
        filled.store.leases.finish(claim.chunk_id, claim.lease_token, "0" * 64, 1)
    reaper(filled).reap()
    assert not is_deleted(filled)
    with pytest.raises(Conflict, match=f"The job {other.id} of this capture is unfinished"):
        filled.store.sessions.delete_videos(filled.session.id)
    filled.store.jobs.cancel(other.id)
    reaper(filled).reap()
    assert is_deleted(filled)


def test_reaper_that_was_killed_is_followed_by_another(filled: RunnerBench) -> None:
    """Rows first, files after them: what is left is removed by the next one."""
    done(filled)
    filled.store.sessions.delete_videos(filled.session.id)
    assert inputs(filled) == ["0-0.jpg", "left.mp4", "rig.toml"]
    filled.store.sessions.delete_videos(filled.session.id)
    reaper(filled).reap()
    assert inputs(filled) == ["rig.toml"]
    reaper(filled).reap()
    assert sum(event.act == "videos-deleted" for event in filled.store.audit.events()) == 1


def test_nothing_goes_before_job_has_succeeded(filled: RunnerBench) -> None:
    with pytest.raises(Conflict, match="No job of this capture has succeeded"):
        filled.store.sessions.delete_videos(filled.session.id)
    filled.stages[DETECT] = fail_with(ValueError())
    job = filled.create_job(spec=ONCE)
    filled.runner().work(60.0)
    assert filled.store.jobs.get(job.id).state is JobState.FAILED
    reaper(filled).reap()
    assert not is_deleted(filled)
    with pytest.raises(NotFound):
        filled.store.tenant("somebody else").sessions.delete_videos(filled.session.id)


def test_edits_and_further_files_need_no_videos(filled: RunnerBench) -> None:
    job = done(filled)
    reaper(filled).reap()
    ran: list[str] = []

    def noted(function: Callable[[Work], Output]) -> Callable[[Work], Output]:
        def run_noted(work: Work) -> Output:
            ran.append(work.claim.stage)
            return function(work)

        return run_noted

    filled.stages |= {name: noted(function) for name, function in filled.stages.items()}
    filled.edit(job.id, *FIRST)
    filled.runner().work(60.0)
    edited = filled.store.jobs.get(job.id)
    assert (edited.state, edited.results_revision) == (JobState.SUCCEEDED, 1)
    other = done(filled, JobSpec(exports=("csv",), smoothing="none"))
    assert filled.result(other.id) == RESULT
    assert not {LOOK, DETECT, REDETECT} & set(ran)


def test_edit_that_failed_is_retried_without_videos(filled: RunnerBench) -> None:
    job = done(filled)
    reaper(filled).reap()
    export = filled.stages["export"]
    filled.stages["export"] = fail_with(ValueError())
    filled.edit(job.id, *FIRST)
    filled.runner().work(60.0)
    failed = filled.store.jobs.get(job.id)
    assert failed.files_state is FilesState.FAILED
    filled.stages["export"] = export
    filled.store.jobs.retry(job.id, plan_again(filled.session, failed))
    filled.runner().work(60.0)
    assert filled.store.jobs.get(job.id).files_state is FilesState.CURRENT


@pytest.mark.parametrize(
    "spec", [JobSpec(profile="fast"), JobSpec(overlay=True), JobSpec(blur_faces=True), JobSpec(people=1)]
)
def test_jobs_that_need_videos_are_refused(filled: RunnerBench, spec: JobSpec) -> None:
    """The last of these tells people apart anew, by colours of clothes that nobody keeps."""
    done(filled)
    filled.store.sessions.delete_videos(filled.session.id)
    with pytest.raises(VideosDeleted):
        filled.create_job(spec=spec)


def test_retry_that_needs_videos_is_refused(filled: RunnerBench) -> None:
    done(filled)
    detect = filled.stages[DETECT]
    filled.stages[DETECT] = fail_with(ValueError())
    failed = filled.create_job(spec=JobSpec(profile="fast"))
    filled.runner().work(60.0)
    filled.stages[DETECT] = detect
    reaper(filled).reap()
    record = filled.store.jobs.get(failed.id)
    with pytest.raises(VideosDeleted):
        filled.store.jobs.retry(failed.id, plan_again(filled.session, record))
    assert filled.store.jobs.get(failed.id).state is JobState.FAILED


def test_people_of_other_code_are_not_edited(filled: RunnerBench) -> None:
    """After an upgrade they would have to be detected again: it is said at once, and the results stay."""
    job = done(filled)
    reaper(filled).reap()
    newer = {stage.name: "f" * 64 for stage in STAGES}
    with pytest.raises(VideosDeleted):
        filled.edit(job.id, *FIRST, codes=newer)
    assert filled.store.jobs.get(job.id).state is JobState.SUCCEEDED
    assert filled.result(job.id) == RESULT


def test_overlays_of_edits_are_not_drawn_nor_tried_for_ever(filled: RunnerBench) -> None:
    job = done(filled, JobSpec(overlay=True, keep_videos=False))
    reaper(filled).reap()
    filled.edit(job.id, *FIRST)
    filled.runner().work(60.0)
    record = filled.store.jobs.get(job.id)
    assert (record.has_old_visuals, record.has_videos) == (True, False)
    assert filled.store.visuals.due(0.0) == []
    with pytest.raises(VideosDeleted):
        filled.make_visuals(job.id)
    # The earlier video stays.
    assert filled.result(job.id, "overlay-left.mp4") == b"video of " + RESULT


def test_report_of_edits_is_written_on_request_without_pictures(filled: RunnerBench) -> None:
    job = done(filled, JobSpec(report=True, keep_videos=False))
    reaper(filled).reap()
    filled.edit(job.id, *FIRST)
    filled.runner().work(60.0)
    assert filled.store.visuals.due(0.0) == []
    filled.make_visuals(job.id)
    filled.runner().work(60.0)
    assert filled.result(job.id, "report.html").startswith(b"report of ")


def test_blurred_videos_are_results_and_stay(filled: RunnerBench) -> None:
    job = done(filled, JobSpec(blur_faces=True, keep_videos=False))
    reaper(filled).reap()
    assert inputs(filled) == ["rig.toml"]
    assert filled.result(job.id, "blurred-0.mp4").startswith(b"blurred by ")


def test_backup_lacks_nothing(filled: RunnerBench) -> None:
    done(filled)
    with filled.store.sessions._access.reading() as connection:
        assert any(path.endswith("left.mp4") for path in named_files(connection, with_artifacts=True))
    reaper(filled).reap()
    with filled.store.sessions._access.reading() as connection:
        named = named_files(connection, with_artifacts=True)
    assert not [path for path in named if path.endswith((".mp4", ".jpg"))]
    assert any(path.endswith("rig.toml") for path in named)


def test_workers_say_that_videos_were_deleted(filled: RunnerBench, tmp_path: Path) -> None:
    """A damaged output that would have to be detected again: the job's problem tells why it can't be."""
    done(filled)
    filled.store.sessions.delete_videos(filled.session.id)
    session = filled.store.sessions.get(filled.session.id)
    seen: list[Work] = []

    def noted(work: Work) -> Output:
        seen.append(replace(work, session=session))
        return Output(b"{}")

    filled.stages["export"] = noted
    done(filled, JobSpec(exports=("csv",)))
    with pytest.raises(InputError) as raised, KeptSession().video(seen[0], "left"):
        pass
    assert [problem.code for problem in raised.value.problems] == ["videos_deleted"]


def test_stages_that_read_videos_say_so() -> None:
    """Those that decode pictures; a report is written without them."""
    declared = {stage.name for stage in STAGES if stage.reads_videos}
    assert declared == {LOOK, DETECT, "find_board", PROXY, REDETECT, OVERLAY, RECORD, BLUR}
