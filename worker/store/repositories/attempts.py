"""Attempts of jobs, and failed tries of chunks with their problems."""

from dataclasses import asdict
from itertools import groupby
from typing import Any

from sqlalchemy import Connection, Row, insert, select

from worker.store.database.connection import now
from worker.store.database.rows import read
from worker.store.database.tables import attempts, failures
from worker.store.model.job_records import Attempt, Failure, JobProblem
from worker.store.model.states import FINISHED, JobState

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
