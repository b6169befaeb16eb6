"""Deletion of videos in each database, beside requests that want them at the same moment."""

import hashlib
from concurrent.futures import ThreadPoolExecutor

import pytest

from pipeline.core.options.job_choices import BLURRED_KIND
from tests.worker.store.conftest import StoreBench, stages
from worker.store.errors import Conflict, VideosDeleted
from worker.store.model.job_records import Result
from worker.store.model.states import JobState
from worker.store.spec import JobSpec

ONCE = JobSpec(keep_videos=False)


def succeed(jobs: StoreBench, spec: JobSpec = ONCE) -> str:
    job = jobs.store.jobs.add(jobs.session_id, spec, stages())
    jobs.finish_all()
    assert jobs.store.jobs.get(job.id).state is JobState.SUCCEEDED
    return job.id


def test_sessions_whose_videos_are_superfluous(jobs: StoreBench) -> None:
    store = jobs.store
    succeed(jobs, JobSpec())
    assert store.sessions.with_superfluous_videos() == []
    job = store.jobs.add(jobs.session_id, ONCE, stages())
    assert store.sessions.with_superfluous_videos() == []
    jobs.finish_all()
    assert store.sessions.with_superfluous_videos() == [jobs.session_id]
    other = store.jobs.add(jobs.session_id, JobSpec(), stages())
    assert store.sessions.with_superfluous_videos() == []
    store.jobs.cancel(other.id)
    store.jobs.delete(other.id)
    store.sessions.delete_videos(jobs.session_id)
    assert store.sessions.with_superfluous_videos() == []
    video = store.sessions.get(jobs.session_id).files[0]
    due = [removal.prefix for removal in store.removals.due()]
    assert video.key in due
    assert f"sessions/{jobs.session_id}/thumbnails/" in due
    # Neither the calibration nor the outputs of stages go.
    assert not [prefix for prefix in due if prefix.startswith(f"sessions/{jobs.session_id}/stages")]
    assert store.jobs.get(job.id).state is JobState.SUCCEEDED


def test_room_of_tenant_comes_back(jobs: StoreBench) -> None:
    succeed(jobs)
    before = jobs.store.tenant("default").usage().stored_bytes
    jobs.store.sessions.delete_videos(jobs.session_id)
    assert before - jobs.store.tenant("default").usage().stored_bytes == 3_000_000_000


@pytest.mark.parametrize("attempt", range(4))
def test_job_and_video_deletion_at_once(jobs: StoreBench, attempt: int) -> None:
    """One of them is refused: no job begins without the videos that it needs."""
    succeed(jobs)

    def add() -> bool:
        try:
            # One more chunk than the job before has detected.
            jobs.store.jobs.add(jobs.session_id, JobSpec(), stages(4))
        except VideosDeleted:
            return False
        return True

    def delete() -> bool:
        try:
            jobs.store.sessions.delete_videos(jobs.session_id)
        except Conflict:
            return False
        return True

    with ThreadPoolExecutor(2) as pool:
        acts = (add, delete) if attempt % 2 else (delete, add)
        first, second = [pool.submit(act) for act in acts]
        assert first.result() != second.result()


def test_blurred_videos_of_session(jobs: StoreBench) -> None:
    blurring = JobSpec(blur_faces=True)
    job = jobs.store.jobs.add(jobs.session_id, blurring, stages())
    claim = jobs.claim()
    made = Result("blurred-0.mp4", BLURRED_KIND, None, "video/mp4", f"jobs/{job.id}/blurred/x/x", 1, _digest())
    jobs.store.leases.finish(claim.chunk_id, claim.lease_token, _digest(), 7, results=[made])
    capture = jobs.store.sessions.capture(jobs.session_id)
    assert (capture.is_blurred, capture.blurred) == (True, frozenset({"blurred-0.mp4"}))
    assert jobs.store.results.blurred(jobs.session_id, "blurred-0.mp4") == made
    assert jobs.store.tenant("somebody else").results.blurred(jobs.session_id, "blurred-0.mp4") is None
    jobs.finish_all()
    plain = jobs.store.jobs.add(jobs.session_id, JobSpec(), stages())
    assert jobs.store.sessions.capture(jobs.session_id).is_blurred
    jobs.store.jobs.cancel(plain.id)
    jobs.store.jobs.delete(job.id)
    assert not jobs.store.sessions.capture(jobs.session_id).is_blurred


def _digest() -> str:
    return hashlib.sha256(b"").hexdigest()
