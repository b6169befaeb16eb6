"""Speed of networks, measured on the chunks of the newest jobs."""

import pytest
import sqlalchemy as sa

from tests.worker.store.conftest import UNITS, StoreBench
from worker.store.database.tables import chunks
from worker.store.model.states import ChunkState


def finish_job(jobs: StoreBench, num_chunks: int, chunk_s: float) -> None:
    """Job of which each chunk took so long."""
    job = jobs.queue(num_chunks)
    jobs.finish_all()
    of_job = (chunks.c.job_id == job.id) & (chunks.c.state == ChunkState.DONE)
    jobs.execute(sa.update(chunks).where(of_job).values(claimed_at=chunks.c.finished_at - chunk_s))


def test_the_speed_is_that_of_the_newest_jobs(jobs: StoreBench) -> None:
    assert jobs.store.speeds.frame_s() is None
    finish_job(jobs, 3, 5.0)
    assert jobs.store.speeds.frame_s() is None  # too few tell
    finish_job(jobs, 9, 20.0)
    assert jobs.store.speeds.frame_s() == pytest.approx(20.0 / UNITS)
    for _ in range(20):
        finish_job(jobs, 1, 1.0)
    assert jobs.store.speeds.frame_s() == pytest.approx(1.0 / UNITS)


def test_chunks_that_nobody_worked_on_tell_no_speed(jobs: StoreBench) -> None:
    finish_job(jobs, 6, 5.0)
    jobs.execute(sa.update(chunks).values(reused=True))
    assert jobs.store.speeds.frame_s() is None
    jobs.execute(sa.update(chunks).values(reused=False, claimed_at=None))  # of older versions
    assert jobs.store.speeds.frame_s() is None
    jobs.queue(9)
    for _ in range(5):
        jobs.finish(jobs.claim())
    assert jobs.store.speeds.frame_s() is None  # the job has not succeeded


def test_a_session_keeps_the_length_of_its_chunks(jobs: StoreBench) -> None:
    before = jobs.store.sessions.get(jobs.session_id)
    session_id = jobs.store.sessions.reserve_id()
    jobs.store.sessions.add("take", before.files, before.preflight, session_id, chunk_frames=400)
    assert (before.chunk_frames, jobs.store.sessions.get(session_id).chunk_frames) == (100, 400)
