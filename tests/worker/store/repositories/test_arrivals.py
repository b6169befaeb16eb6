"""Sessions whose videos are fetched, and jobs that wait for them."""

from typing import Any

import pytest
from uuid_utils import uuid7

from pipeline.capture.preflight_record import Preflight, PreflightTimebase
from tests.worker.store.conftest import LEASE_S, PREFLIGHT, StoreBench, stages
from worker.store.database.tables import sessions, uploads
from worker.store.errors import Conflict, NotFound
from worker.store.model.job_records import JobProblem, JobRecord
from worker.store.model.session_records import InputFile, Session
from worker.store.model.states import JobState
from worker.store.spec import JobSpec
from worker.store.tenant_records import TenantRecords

URL = "https://store.example/cam_0.mp4?signature=secret"
NO_PREFLIGHT = Preflight((), PreflightTimebase(0.0, 25.0, 0), ())


def begun(records: TenantRecords) -> tuple[str, str]:
    """Ids of a session and of the upload that it waits for."""
    session_id, upload_id = records.sessions.reserve_id(), str(uuid7())
    with records.transaction() as work:
        work.sessions.add("take", [], NO_PREFLIGHT, session_id, arrival={"videos": [upload_id]})
        work.uploads.add(upload_id, "cam_0.mp4", 0, "", 3600.0, "host:/uploads", URL)
        work.arrivals.reserve(session_id, [upload_id])
    return session_id, upload_id


def completed(records: TenantRecords, session_id: str, outcome: Any = None) -> bool:
    file = InputFile("cam_0.mp4", "video", f"sessions/{session_id}/inputs/0-cam_0.mp4", 70, "1" * 64)

    def plan(session: Session, job: JobRecord) -> Any:
        assert (session.files, session.state, job.num_frames) == ((file,), "ready", PREFLIGHT.timebase.num_frames)
        return outcome or stages(3)

    return records.arrivals.complete(session_id, [file], PREFLIGHT, "2" * 64, 50, plan)


def test_session_is_due_when_all_fetches_ended(jobs: StoreBench) -> None:
    mine = jobs.store.tenant("mine")
    session_id, upload_id = begun(mine)
    assert mine.sessions.capture(session_id).session.state == "fetching"
    assert mine.arrivals.due() == []
    mine.uploads.end_fetch(upload_id, JobProblem("source_broken", "It broke."))  # type: ignore[arg-type]
    (arrival,) = mine.arrivals.due()
    assert (arrival.session_id, arrival.tenant, arrival.body) == (session_id, "mine", {"videos": [upload_id]})
    assert [upload.id for upload in arrival.uploads] == [upload_id]
    assert jobs.store.tenant("theirs").arrivals.due() == []
    assert mine.arrivals.claim(session_id, LEASE_S)
    assert not mine.arrivals.claim(session_id, LEASE_S)
    assert mine.arrivals.due() == []


def test_expired_upload_lets_its_session_be_due(jobs: StoreBench) -> None:
    mine = jobs.store.tenant("mine")
    session_id, _ = begun(mine)
    jobs.execute(uploads.update().values(expires_at=1.0))
    assert [arrival.session_id for arrival in mine.arrivals.due()] == [session_id]


def test_renewed_fetch_keeps_all_uploads_of_its_session(jobs: StoreBench) -> None:
    mine = jobs.store.tenant("mine")
    session_id, upload_id = begun(mine)
    other_id = mine.uploads.add(str(uuid7()), "rig.toml", 9, "", 60.0, "host:/uploads").id
    free_id = mine.uploads.add(str(uuid7()), "free.toml", 9, "", 60.0, "host:/uploads").id
    mine.arrivals.reserve(session_id, [other_id])
    before = mine.uploads.get(free_id).expires_at
    assert mine.uploads.renew_fetches({upload_id: 5, "gone": 7}, LEASE_S, 7200.0) == {upload_id}
    assert mine.uploads.get(upload_id).fetched_bytes == 5
    assert mine.uploads.get(other_id).expires_at > before
    assert mine.uploads.get(free_id).expires_at == before
    mine.arrivals.renew([session_id], LEASE_S, 9000.0)
    assert mine.uploads.get(other_id).expires_at > mine.uploads.get(free_id).expires_at


def test_completed_session_begins_its_jobs_once(jobs: StoreBench) -> None:
    mine = jobs.store.tenant("mine")
    session_id, upload_id = begun(mine)
    waiting, canceled = (mine.jobs.add(session_id, JobSpec(), ()) for _ in range(2))
    assert mine.jobs.cancel(canceled.id).state == JobState.CANCELED
    assert (waiting.waiting_for and waiting.waiting_for.code, waiting.progress) == ("videos_fetching", 0.0)
    assert jobs.store.leases.claim("worker", LEASE_S) is None
    assert completed(mine, session_id)
    assert not completed(mine, session_id)
    session = mine.sessions.get(session_id)
    assert (session.state, session.record_sha256, session.chunk_frames) == ("ready", "2" * 64, 50)
    with pytest.raises(NotFound):
        mine.uploads.get(upload_id)
    assert jobs.claim().job_id == waiting.id
    assert mine.jobs.get(waiting.id).waiting_for is None
    assert mine.jobs.get(canceled.id).stages == ()
    with pytest.raises(Conflict, match="just now"):
        mine.jobs.add(session_id, JobSpec(), ())
    assert mine.usage().stored_bytes == 70


def test_job_without_plan_fails_alone(jobs: StoreBench) -> None:
    mine = jobs.store.tenant("mine")
    session_id, _ = begun(mine)
    job = mine.jobs.add(session_id, JobSpec(), ())
    assert completed(mine, session_id, JobProblem("space_missing", "No room."))  # type: ignore[arg-type]
    ended = mine.jobs.get(job.id)
    assert (ended.state, ended.problem and ended.problem.detail) == (JobState.FAILED, "No room.")
    assert mine.sessions.get(session_id).state == "ready"


def test_failed_session_keeps_its_errors(jobs: StoreBench) -> None:
    mine = jobs.store.tenant("mine")
    session_id, _ = begun(mine)
    job = mine.jobs.add(session_id, JobSpec(), ())
    errors = [{"code": "source_broken", "message": "It broke.", "file": "cam_0.mp4", "pointer": "/videos/0"}]
    assert mine.arrivals.fail(session_id, errors)
    assert not mine.arrivals.fail(session_id, [])
    assert not completed(mine, session_id)
    capture = mine.sessions.capture(session_id)
    assert (capture.session.state, capture.session.errors, capture.uploads) == ("failed", tuple(errors), ())
    problem = mine.jobs.get(job.id).problem
    assert problem is not None
    assert (problem.code, problem.errors[0].file, problem.retryable) == ("session_unusable", "cam_0.mp4", False)
    for may_wait in (False, True):
        with pytest.raises(Conflict):
            mine.sessions.get(session_id, may_wait=may_wait)
    assert mine.usage().stored_bytes == 0


def test_deleted_session_takes_its_uploads_along(jobs: StoreBench) -> None:
    mine = jobs.store.tenant("mine")
    session_id, upload_id = begun(mine)
    assert jobs.store.uploads.due_fetches() != []
    mine.sessions.delete(session_id)
    assert mine.uploads.known([upload_id]) == set()
    assert not completed(mine, session_id)
    assert not mine.arrivals.fail(session_id, [])


def test_reserved_upload_has_no_second_user(jobs: StoreBench) -> None:
    mine = jobs.store.tenant("mine")
    session_id, upload_id = begun(mine)
    with pytest.raises(Conflict):
        mine.uploads.use([upload_id])
    with pytest.raises(Conflict):
        mine.arrivals.reserve(session_id, [upload_id])
    with pytest.raises(Conflict):
        jobs.store.tenant("theirs").arrivals.reserve(session_id, [upload_id])


def test_session_that_is_fetched_is_read_by_few(jobs: StoreBench) -> None:
    mine = jobs.store.tenant("mine")
    session_id, _ = begun(mine)
    with pytest.raises(Conflict):
        mine.sessions.get(session_id)
    assert mine.sessions.get(session_id, may_wait=True).arrival is not None
    jobs.execute(sessions.update().where(sessions.c.id == session_id).values(arrival_due_at=1.0))
    assert [found.session.id for found in mine.sessions.page()] == [session_id]
