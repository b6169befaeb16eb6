"""Transitions of jobs and chunks from state to state, inside a transaction of the caller.

Every change of a job or its chunks locks the job first, and before a job that makes visuals, if they change, the
reconstruction that lists them. So two changes of one job never overlap and never wait for each other in a circle. (A
heartbeat updates one row and locks nothing else.)
"""

from collections.abc import Collection
from dataclasses import asdict
from itertools import groupby
from typing import Any, Literal

from sqlalchemy import Connection, Row, delete, insert, select, update

from pipeline.core.options.job_choices import BLURRED_KIND, VISUAL_KINDS
from worker.store.database.connection import now
from worker.store.database.rows import read
from worker.store.database.stored_files import drop_results, remove_later
from worker.store.database.tables import attempts, chunks, events, failures, jobs, results
from worker.store.database.totals import Total, count
from worker.store.files.file_keys import interim_prefix, job_prefix
from worker.store.model.job_records import Attempt, Failure, JobProblem
from worker.store.model.states import FINISHED, JOB_TRANSITIONS, ChunkState, JobState
from worker.store.repositories.webhooks import queue_delivery

EventKind = Literal["state", "stage", "waiting"]

_NO_LEASE = {"lease_token": None, "lease_until": None}
_ENDED = frozenset({ChunkState.DONE, ChunkState.FAILED, ChunkState.CANCELED})


def lock_job(connection: Connection, job_id: str) -> Row[Any] | None:
    """Lock a job until the transaction ends, and return its row; ``None`` if there is no such job."""
    return connection.execute(select(jobs).where(jobs.c.id == job_id).with_for_update()).one_or_none()


def note(connection: Connection, job_id: str, kind: EventKind, value: str) -> None:
    """Add an event of a locked job, or of one that no other transaction can see yet."""
    connection.execute(insert(events).values(job_id=job_id, created_at=now(), kind=kind, value=value))


def move_job(connection: Connection, job_id: str, to: JobState, **values: Any) -> bool:
    """Move a job to a state if its state allows it; return whether it was moved."""
    sources = [source for source, targets in JOB_TRANSITIONS.items() if to in targets]
    ends = to in FINISHED - {JobState.EXPIRED}
    query = select(jobs.c.results_revision).where(jobs.c.id == job_id)
    had_files = ends and connection.scalar(query) is not None
    if ends:
        values |= {"finished_at": now(), "expires_at": now() + jobs.c.retention_s, "waiting_for": None}
    if to is JobState.SUCCEEDED:
        values["results_revision"] = jobs.c.revision
    moved = connection.execute(
        update(jobs).where(jobs.c.id == job_id, jobs.c.state.in_(sources)).values(state=to, **values)
    )
    if moved.rowcount == 1:
        note(connection, job_id, "state", to)
        if ends:
            job = connection.execute(select(jobs).where(jobs.c.id == job_id)).one()
            remove_later(connection, interim_prefix(job_id, job.attempt))
            if to is JobState.SUCCEEDED:
                is_visual = results.c.kind.in_(VISUAL_KINDS)
                of_same_kind = (
                    is_visual if job.reconstruction_id is not None else ~is_visual & (results.c.kind != BLURRED_KIND)
                )
                drop_results(
                    connection, job.reconstruction_id or job.id, of_same_kind & (results.c.revision < job.revision)
                )
        if to in FINISHED:
            count(connection, Total.JOBS_ENDED, to)
            queue_delivery(connection, job_id, of_files=had_files)
    return moved.rowcount == 1


def delete_visuals_job(connection: Connection, job_id: str) -> None:
    """Delete the job that makes visuals of a locked job; a worker that makes them stops when it finds its job gone."""
    for visuals_id in connection.scalars(select(jobs.c.id).where(jobs.c.reconstruction_id == job_id)).all():
        remove_later(connection, job_prefix(visuals_id))
        connection.execute(delete(jobs).where(jobs.c.id == visuals_id))


def set_waiting(connection: Connection, job: Row[Any], problem: JobProblem | None) -> None:
    """Set the outage that a locked job waits for; ``None``: it does not wait any more."""
    before = None if job.waiting_for is None else job.waiting_for["code"]
    after = None if problem is None else problem.code
    if before == after:
        return
    document = None if problem is None else asdict(problem)
    connection.execute(update(jobs).where(jobs.c.id == job.id).values(waiting_for=document))
    note(connection, job.id, "waiting", after or "")


def move_chunk(connection: Connection, chunk_id: int, to: ChunkState, **values: Any) -> None:
    """Move a chunk whose job is locked to a state, and end its lease."""
    if to in _ENDED:
        values["finished_at"] = now()
    connection.execute(update(chunks).where(chunks.c.id == chunk_id).values(state=to, **_NO_LEASE, **values))


def cancel_chunks(connection: Connection, job_id: str, states: Collection[ChunkState]) -> None:
    """Cancel the chunks of a locked job that are in some states."""
    connection.execute(
        update(chunks)
        .where(chunks.c.job_id == job_id, chunks.c.state.in_(states))
        .values(state=ChunkState.CANCELED, finished_at=now(), **_NO_LEASE)
    )


def advance(connection: Connection, job_id: str, stage_index: int) -> bool:
    """Begin the next stage after the last chunk of a stage, or end the job; return whether chunks became ready.

    The next stage is the first one that is not done: an earlier one while outputs are computed again.
    """
    unfinished = select(chunks.c.id).where(
        chunks.c.job_id == job_id, chunks.c.stage_index == stage_index, chunks.c.state != ChunkState.DONE
    )
    if connection.execute(unfinished.limit(1)).first() is not None:
        return False
    not_done = (
        select(chunks.c.stage_index, chunks.c.stage)
        .where(chunks.c.job_id == job_id, chunks.c.state != ChunkState.DONE)
        .order_by(chunks.c.stage_index)
    )
    next_stage = connection.execute(not_done.limit(1)).one_or_none()
    if next_stage is None:
        move_job(connection, job_id, JobState.SUCCEEDED)
        return False
    waiting = (
        chunks.c.job_id == job_id,
        chunks.c.stage_index == next_stage.stage_index,
        chunks.c.state == ChunkState.WAITING,
    )
    if connection.execute(update(chunks).where(*waiting).values(state=ChunkState.READY)).rowcount == 0:
        return False
    note(connection, job_id, "stage", next_stage.stage)
    return True


def fail_job(connection: Connection, job_id: str, chunk_id: int, problem: JobProblem) -> None:
    """Fail a locked job by the problem of a chunk; its other chunks are canceled, and workers lose their leases."""
    move_chunk(connection, chunk_id, ChunkState.FAILED)
    cancel_chunks(connection, job_id, (ChunkState.WAITING, ChunkState.READY, ChunkState.RUNNING))
    move_job(connection, job_id, JobState.FAILED, problem=asdict(problem))


def settle_canceling(connection: Connection, job_id: str) -> None:
    """End a locked job that is being canceled, unless one of its chunks still runs."""
    running = select(chunks.c.id).where(chunks.c.job_id == job_id, chunks.c.state == ChunkState.RUNNING)
    if connection.execute(running.limit(1)).first() is None:
        move_job(connection, job_id, JobState.CANCELED)


_KEPT = ("attempt", "state", "problem", "queued_at", "started_at", "finished_at")


def note_failure(connection: Connection, job: Row[Any], chunk: Row[Any], problem: JobProblem) -> None:
    """Add a failed try of a chunk whose job is locked."""
    connection.execute(
        insert(failures).values(
            job_id=job.id,
            attempt=job.attempt,
            stage=chunk.stage,
            chunk_index=chunk.chunk_index,
            chunk_try=chunk.attempt,
            problem=asdict(problem),
            failed_at=now(),
        )
    )


def keep_attempt(connection: Connection, job: Row[Any]) -> None:
    """Keep the present attempt of a locked job, before the next one replaces it; one that has not ended is canceled."""
    columns = {name: getattr(job, name) for name in _KEPT}
    for name in ("queued_at", "started_at", "finished_at"):
        columns[name] = columns[name].timestamp() if columns[name] else None
    if job.state not in FINISHED:
        columns |= {"state": JobState.CANCELED, "finished_at": now()}
    connection.execute(insert(attempts).values(job_id=job.id, **columns))


def read_attempts(connection: Connection, job: Row[Any]) -> list[Attempt]:
    """Attempts of a job, the first one first."""
    earlier = connection.execute(select(attempts).where(attempts.c.job_id == job.id).order_by(attempts.c.attempt))
    found = connection.execute(
        select(failures).where(failures.c.job_id == job.id).order_by(failures.c.attempt, failures.c.id)
    )
    by_attempt = groupby(found, key=lambda row: row.attempt)
    failed = {attempt: tuple(read(Failure, row) for row in rows) for attempt, rows in by_attempt}
    return [read(Attempt, row, failures=failed.get(row.attempt, ())) for row in (*earlier, job)]
