from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa
import uuid_utils

from pipeline.core.findings import Finding
from pipeline.core.problems.code_group import Code
from pipeline.core.problems.finding_codes import FEW_VIEWS
from pipeline.core.problems.session_codes import VIDEO_TRUNCATED
from tests.worker.store.conftest import PREFLIGHT, UNITS, StoreBench, new_session, result, stages
from worker.store.database import tables
from worker.store.errors import Conflict, NoResults, NotFinished, NotFound
from worker.store.model.job_records import JobProblem
from worker.store.model.session_records import InputFile
from worker.store.model.states import ChunkState, JobState
from worker.store.spec import JobSpec
from worker.store.store import JobStore

NOBODY = str(uuid_utils.uuid7())

BROKEN = JobProblem(VIDEO_TRUNCATED, "The video ends early.", stage="detect", camera="cam one", hint="Copy it again.")


def test_session_is_read_as_written(jobs: StoreBench) -> None:
    session = jobs.store.sessions.get(jobs.session_id)
    assert session.name == "take"
    assert session.files[0] == InputFile(
        "cam one.mp4", "video", f"sessions/{session.id}/inputs/0-cam_one.mp4", 3_000_000_000, "1" * 64
    )
    assert session.files[1].kind == "calibration"
    assert session.preflight == PREFLIGHT


def test_lists_are_paged_from_newest(jobs: StoreBench) -> None:
    session_ids = [jobs.session_id, *(new_session(jobs.store) for _ in range(4))][::-1]
    job_ids = [jobs.queue(1).id for _ in range(5)][::-1]

    def session_page(after: str | None) -> list[str]:
        return [capture.session.id for capture in jobs.store.sessions.page(limit=2, after=after)]

    def job_page(after: str | None) -> list[str]:
        return [job.id for job in jobs.store.jobs.page(limit=2, after=after)]

    for ids, page in ((session_ids, session_page), (job_ids, job_page)):
        first = page(None)
        second = page(first[-1])
        third = page(second[-1])
        assert [first, second, third] == [ids[:2], ids[2:4], ids[4:]]
        assert page(third[-1]) == []


def test_page_continues_after_deleted_item(jobs: StoreBench) -> None:
    oldest, middle, _ = (jobs.queue(1).id for _ in range(3))
    jobs.store.jobs.cancel(middle)
    jobs.store.jobs.delete(middle)
    assert [job.id for job in jobs.store.jobs.page(after=middle)] == [oldest]


def test_jobs_by_state(jobs: StoreBench) -> None:
    canceled, queued = jobs.queue(), jobs.queue()
    jobs.store.jobs.cancel(canceled.id)
    assert [job.id for job in jobs.store.jobs.page(JobState.CANCELED)] == [canceled.id]
    assert [job.id for job in jobs.store.jobs.page(JobState.QUEUED)] == [queued.id]
    assert jobs.store.jobs.page(JobState.RUNNING) == []


def test_jobs_by_session(jobs: StoreBench) -> None:
    other = new_session(jobs.store)
    first, second = jobs.queue(), jobs.queue()
    jobs.store.jobs.add(other, JobSpec(), stages())
    assert [job.id for job in jobs.store.jobs.page(session_id=jobs.session_id)] == [second.id, first.id]
    assert [job.id for job in jobs.store.jobs.page(session_id=jobs.session_id, after=second.id)] == [first.id]
    assert (first.session_name, first.num_frames, first.duration_s) == ("take", 60, 2.4)


def test_jobs_of_session_use_its_index(tmp_path: Path) -> None:
    store = JobStore(f"sqlite:///{tmp_path / 'multicap.db'}")
    store.migrate()
    said: list[str] = []

    @sa.event.listens_for(sa.Engine, "before_cursor_execute")
    def explain(connection: sa.Connection, cursor: Any, statement: str, parameters: Any, *_: object) -> None:
        if "jobs.session_id =" in statement and "LIMIT" in statement:
            rows = connection.connection.execute(f"EXPLAIN QUERY PLAN {statement}", parameters).fetchall()
            said.extend(str(row[3]) for row in rows)

    try:
        store.jobs.page(session_id=str(uuid_utils.uuid7()))
        store.jobs.page(session_id=str(uuid_utils.uuid7()), after=str(uuid_utils.uuid7()))
    finally:
        sa.event.remove(sa.Engine, "before_cursor_execute", explain)
        store.close()
    looks = [one for one in said if one.startswith("SEARCH jobs")]
    assert [one.split("(")[1].rstrip(")") for one in looks] == ["session_id=?", "session_id=? AND id<?"]
    assert not any("TEMP B-TREE FOR ORDER BY" in one for one in said)


def test_job_new_has_first_stage_ready(jobs: StoreBench) -> None:
    job = jobs.queue(num_chunks=4)
    assert (job.state, job.attempt, job.progress, job.spec) == (JobState.QUEUED, 1, 0.0, JobSpec())
    assert [(stage.name, stage.state, stage.done, stage.total) for stage in job.stages] == [
        ("detect", ChunkState.READY, 0, 4 * UNITS),
        ("export", ChunkState.WAITING, 0, UNITS),
    ]
    assert job.warnings == PREFLIGHT.findings
    assert (job.started_at, job.finished_at, job.problem) == (None, None, None)
    assert jobs.store.jobs.get(job.id) == job == jobs.store.jobs.page()[0]


def test_job_without_work_is_refused(jobs: StoreBench) -> None:
    with pytest.raises(ValueError, match="chunk"):
        jobs.store.jobs.add(jobs.session_id, JobSpec(), stages(0))
    with pytest.raises(Conflict, match="just now"):  # its videos are not fetched
        jobs.store.jobs.add(jobs.session_id, JobSpec(), ())
    assert jobs.store.jobs.page() == []


def test_thousands_of_chunks(jobs: StoreBench) -> None:
    job = jobs.queue(2500)
    detect, export = jobs.store.jobs.get(job.id).stages
    assert (detect.total, export.total) == (2500 * UNITS, UNITS)
    assert [one.key for one in jobs.store.outputs.list_stage(job.id, "detect")] == [f"detect-{k}" for k in range(2500)]


def test_places_in_queue(jobs: StoreBench) -> None:
    first, second, third = jobs.queue(), jobs.queue(), jobs.queue()
    assert [jobs.store.jobs.get(job.id).queue_position for job in (first, second, third)] == [1, 2, 3]
    jobs.claim()
    assert [jobs.store.jobs.get(job.id).queue_position for job in (first, second, third)] == [None, 1, 2]
    jobs.store.jobs.cancel(second.id)
    assert [job.queue_position for job in jobs.store.jobs.page()] == [1, None, None]
    jobs.store.jobs.retry(second.id, stages())
    assert [job.queue_position for job in jobs.store.jobs.page()] == [1, 2, None]


def test_job_progress_follows_chunks(jobs: StoreBench) -> None:
    job_id = jobs.queue(num_chunks=2).id
    first, second = jobs.claim(), jobs.claim()
    jobs.store.leases.heartbeat(first.chunk_id, first.lease_token, 5, 60)
    job = jobs.store.jobs.get(job_id)
    assert (job.state, job.progress) == (JobState.RUNNING, 5 / 30)
    assert job.started_at is not None
    assert (job.stages[0].state, job.stages[0].done) == (ChunkState.RUNNING, 5)
    jobs.finish(second)
    job = jobs.store.jobs.get(job_id)
    assert (job.progress, job.stages[0].finished_at) == (15 / 30, None)
    jobs.finish(first)
    job = jobs.store.jobs.get(job_id)
    assert [stage.state for stage in job.stages] == [ChunkState.DONE, ChunkState.READY]
    assert job.stages[0].finished_at is not None
    jobs.finish(jobs.claim())
    job = jobs.store.jobs.get(job_id)
    assert (job.state, job.progress, job.problem) == (JobState.SUCCEEDED, 1.0, None)
    assert job.created_at <= job.started_at <= job.finished_at  # type: ignore[operator]


def test_stage_between_two_workers_is_running(jobs: StoreBench) -> None:
    job_id = jobs.queue(num_chunks=2).id
    jobs.finish(jobs.claim())
    assert jobs.store.jobs.get(job_id).stages[0].state == ChunkState.RUNNING


def test_stage_is_reused_if_all_chunks_were(jobs: StoreBench) -> None:
    job_id = jobs.queue(num_chunks=2).id
    for reused in (False, True, True):
        claim = jobs.claim()
        jobs.store.leases.finish(claim.chunk_id, claim.lease_token, "0" * 64, 1, reused=reused)
    assert [stage.reused for stage in jobs.store.jobs.get(job_id).stages] == [False, True]


def test_cancel_of_queued_job_is_immediate(jobs: StoreBench) -> None:
    job = jobs.store.jobs.cancel(jobs.queue().id)
    assert job.state == JobState.CANCELED
    assert job.finished_at is not None
    assert {stage.state for stage in job.stages} == {ChunkState.CANCELED}
    assert jobs.store.leases.claim("worker", 60) is None


def test_cancel_of_running_job_waits_for_its_workers(jobs: StoreBench) -> None:
    job_id = jobs.queue(num_chunks=3).id
    first, second = jobs.claim(), jobs.claim()
    assert jobs.store.jobs.cancel(job_id).state == JobState.CANCELING
    assert jobs.store.jobs.cancel(job_id).state == JobState.CANCELING
    assert jobs.store.leases.claim("worker", 60) is None
    assert not jobs.store.leases.heartbeat(first.chunk_id, first.lease_token, 1, 60)
    assert not jobs.store.leases.release(first.chunk_id, first.lease_token)
    assert jobs.store.jobs.get(job_id).state == JobState.CANCELING
    assert not jobs.finish(second)
    assert jobs.store.jobs.get(job_id).state == JobState.CANCELED
    assert jobs.store.outputs.find(jobs.session_id, second.output_key) is not None


def test_retry_starts_over_and_keeps_finished_outputs(jobs: StoreBench) -> None:
    job_id = jobs.queue(num_chunks=2).id
    done = jobs.claim()
    jobs.finish(done)
    broken = jobs.claim()
    jobs.store.leases.fail(broken.chunk_id, broken.lease_token, BROKEN)
    failed = jobs.store.jobs.get(job_id)
    assert (failed.state, failed.problem) == (JobState.FAILED, BROKEN)

    again = jobs.store.jobs.retry(job_id, stages(2))
    assert (again.state, again.attempt, again.progress, again.problem) == (JobState.QUEUED, 2, 0.0, None)
    assert (again.started_at, again.finished_at) == (None, None)
    claim = jobs.claim()
    assert (claim.index, claim.attempt) == (0, 1)
    assert claim.chunk_id > broken.chunk_id
    assert jobs.store.outputs.find(jobs.session_id, claim.output_key) == (done.output_key.ljust(64, "0"), 7)
    assert jobs.store.outputs.find(jobs.session_id, broken.output_key) is None
    assert not jobs.finish(broken)


def test_attempts_say_what_became_of_each(jobs: StoreBench) -> None:
    job_id = jobs.queue(num_chunks=1).id
    claim = jobs.claim()
    jobs.store.leases.fail(claim.chunk_id, claim.lease_token, BROKEN)
    jobs.store.jobs.retry(job_id, stages(1))
    jobs.store.jobs.cancel(job_id)
    jobs.store.jobs.retry(job_id, stages(1))
    jobs.finish_all()
    first, second, third = jobs.store.jobs.attempts(job_id)
    assert (first.attempt, first.state, first.problem) == (1, JobState.FAILED, BROKEN)
    assert [(one.chunk_try, one.problem) for one in first.failures] == [(1, BROKEN)]
    assert (second.attempt, second.state, second.problem, second.failures) == (2, JobState.CANCELED, None, ())
    assert second.started_at is None
    assert (third.attempt, third.state, third.problem, third.failures) == (3, JobState.SUCCEEDED, None, ())
    moments = [moment for one in (first, second, third) for moment in (one.queued_at, one.finished_at) if moment]
    assert (len(moments), moments) == (6, sorted(moments))


def test_retry_goes_to_end_of_queue(jobs: StoreBench) -> None:
    first, second = jobs.queue(1), jobs.queue(1)
    jobs.store.jobs.cancel(first.id)
    jobs.store.jobs.retry(first.id, stages(1))
    assert [jobs.claim().job_id for _ in range(2)] == [second.id, first.id]


def test_outputs_are_in_order_of_chunks(jobs: StoreBench) -> None:
    job_id = jobs.queue(num_chunks=12).id
    assert [one.key for one in jobs.store.outputs.list_stage(job_id, "detect")] == [f"detect-{k}" for k in range(12)]
    assert [one.key for one in jobs.store.outputs.list_stage(job_id, "export")] == ["export"]


def test_results(jobs: StoreBench) -> None:
    job_id = jobs.queue(num_chunks=1).id
    for act in (lambda: jobs.store.results.downloads(job_id), lambda: jobs.store.results.get(job_id, "person-1.bvh")):
        with pytest.raises(NotFinished):
            act()
    jobs.finish(jobs.claim())
    claim = jobs.claim()
    files = [result(job_id, name) for name in ("skeletons.json", "metrics.json", "person-1.bvh")]
    jobs.store.leases.finish(claim.chunk_id, claim.lease_token, "0" * 64, 1, results=files)
    assert jobs.store.results.downloads(job_id) == sorted(files, key=lambda file: file.name)
    assert jobs.store.results.get(job_id, "metrics.json") == files[1]
    with pytest.raises(NotFound):
        jobs.store.results.get(job_id, "person-2.bvh")


def test_downloads_leave_files_of_viewers_out(jobs: StoreBench) -> None:
    job_id = jobs.queue(num_chunks=1).id
    jobs.finish(jobs.claim())
    claim = jobs.claim()
    download, of_viewer = result(job_id, "metrics.json"), replace(result(job_id, "motion.bin"), kind="viewer")
    jobs.store.leases.finish(claim.chunk_id, claim.lease_token, "0" * 64, 1, results=[download, of_viewer])
    assert jobs.store.results.downloads(job_id) == [download]
    assert jobs.store.results.all(job_id) == [download, of_viewer]
    assert jobs.store.results.get(job_id, "motion.bin") == of_viewer


def test_job_failed_has_no_results(jobs: StoreBench) -> None:
    job_id = jobs.queue().id
    claim = jobs.claim()
    jobs.store.leases.fail(claim.chunk_id, claim.lease_token, BROKEN)
    with pytest.raises(NoResults, match="The job is failed and has no results") as raised:
        jobs.store.results.downloads(job_id)
    assert raised.value.reason == f"{BROKEN.code}: {BROKEN.detail}"


def due(jobs: StoreBench) -> list[str]:
    return [removal.prefix for removal in jobs.store.removals.due()]


def test_delete_job_leaves_session(jobs: StoreBench) -> None:
    job_id = jobs.queue(num_chunks=1).id
    with pytest.raises(Conflict):
        jobs.store.jobs.delete(job_id)
    assert due(jobs) == []
    jobs.finish_all()
    assert due(jobs) == [f"jobs/{job_id}/interim/1/"]
    jobs.store.jobs.delete(job_id)
    assert due(jobs) == [f"jobs/{job_id}/interim/1/", f"jobs/{job_id}/"]
    assert jobs.store.outputs.find(jobs.session_id, "detect-0") is not None
    with pytest.raises(NotFound):
        jobs.store.jobs.get(job_id)


def test_delete_session_takes_its_jobs_along(jobs: StoreBench) -> None:
    done = jobs.queue(num_chunks=1)
    jobs.finish_all()
    canceled = jobs.queue(num_chunks=2)
    with pytest.raises(Conflict):
        jobs.store.sessions.delete(jobs.session_id)
    jobs.store.jobs.cancel(canceled.id)
    jobs.store.sessions.delete(jobs.session_id)
    assert sorted(due(jobs)) == sorted(
        [
            f"jobs/{done.id}/interim/1/",
            f"jobs/{done.id}/",
            f"jobs/{canceled.id}/interim/1/",
            f"jobs/{canceled.id}/",
            f"sessions/{jobs.session_id}/",
        ]
    )
    assert jobs.store.sessions.page() == []
    assert jobs.store.jobs.page() == []
    assert jobs.store.outputs.find(jobs.session_id, "detect-0") is None


def test_records_with_unknown_id_are_not_found(jobs: StoreBench) -> None:
    store = jobs.store
    for act in (
        store.sessions.get,
        store.sessions.delete,
        store.jobs.get,
        store.jobs.delete,
        store.jobs.cancel,
        store.results.downloads,
    ):
        with pytest.raises(NotFound):
            act(NOBODY)
    with pytest.raises(NotFound):
        store.jobs.retry(NOBODY, stages())
    with pytest.raises(NotFound):
        store.jobs.add(NOBODY, JobSpec(), stages())
    with pytest.raises(NotFound):
        store.results.get(NOBODY, "person-1.bvh")


def test_job_finished_has_warnings_of_results(jobs: StoreBench) -> None:
    job_id = jobs.queue(num_chunks=1).id
    jobs.finish(jobs.claim())
    claim = jobs.claim()
    warning = Finding(FEW_VIEWS, "person-1 was seen by two cameras.")
    jobs.store.leases.finish(
        claim.chunk_id, claim.lease_token, "5" * 64, 7, results=[result(job_id)], warnings=[warning]
    )
    job = jobs.store.jobs.get(job_id)
    assert (job.state, job.warnings) == (JobState.SUCCEEDED, (*PREFLIGHT.findings, warning))


def test_retry_drops_warnings_of_earlier_results(jobs: StoreBench) -> None:
    job_id = jobs.queue(num_chunks=1).id
    claim = jobs.claim()
    jobs.store.leases.fail(claim.chunk_id, claim.lease_token, JobProblem(Code("broken"), "It is broken."))
    jobs.execute(sa.update(tables.jobs).values(warnings=[{"code": "few_views", "message": "Few."}]))
    assert [warning.code for warning in jobs.store.jobs.get(job_id).warnings] == ["clocks_disagree", "few_views"]
    assert jobs.store.jobs.retry(job_id, stages(1)).warnings == PREFLIGHT.findings
