"""Outages that work waits for: jobs that wait for the broker, and chunks that were lost without a lost worker."""

from typing import Any

from sqlalchemy import Connection, Row, case, delete, select, update

from pipeline.core.problems.finding_codes import WORKER_LOST
from worker.store.database.access import Transactions
from worker.store.database.tables import chunks, failures, jobs
from worker.store.database.transitions import lock_job, set_waiting
from worker.store.model.job_records import JobProblem
from worker.store.model.states import AT_WORK, ChunkState
from worker.store.model.work import Claim
from worker.store.outages import Outage


class Waits:
    """Waiting work, of all tenants. A chunk that is given back to wait is a matter of ``Leases.give_back``."""

    def __init__(self, transactions: Transactions) -> None:
        self._transactions = transactions

    def begin_broker_outage(self, problem: JobProblem) -> None:
        """Let jobs with ready chunks wait for the broker, unless they wait for something already."""
        ready = select(chunks.c.job_id).where(chunks.c.state == ChunkState.READY)
        waiting = select(jobs.c.id).where(jobs.c.id.in_(ready), jobs.c.state.in_(AT_WORK), jobs.c.waiting_for.is_(None))
        with self._transactions.writing() as connection:
            for job in _locked(connection, list(connection.scalars(waiting.order_by(jobs.c.id)))):
                if job.waiting_for is None and job.state in AT_WORK:
                    set_waiting(connection, job, problem)

    def end_broker_outage(self) -> None:
        """Let no job wait for the broker any more."""
        waiting = select(jobs.c.id).where(jobs.c.state.in_(AT_WORK), jobs.c.waiting_for.is_not(None))
        with self._transactions.writing() as connection:
            for job in _locked(connection, list(connection.scalars(waiting.order_by(jobs.c.id)))):
                if job.waiting_for is not None and job.waiting_for["code"] == Outage.BROKER:
                    set_waiting(connection, job, None)

    def excuse(self, claim: Claim) -> None:
        """Restore the try that a chunk lost to a worker that was cut off from the database, but not lost."""
        lost = (
            select(failures.c.id, failures.c.problem)
            .where(
                failures.c.job_id == claim.job_id,
                failures.c.attempt == claim.job_attempt,
                failures.c.stage == claim.stage,
                failures.c.chunk_index == claim.index,
                failures.c.chunk_try == claim.attempt,
            )
            .order_by(failures.c.id.desc())
            .limit(1)
        )
        restore = (
            update(chunks)
            .where(chunks.c.id == claim.chunk_id, chunks.c.attempt > claim.attempt)
            .values(
                attempt=chunks.c.attempt - 1,
                lost_tries=case((chunks.c.lost_tries > 0, chunks.c.lost_tries - 1), else_=0),
                due_at=None,
            )
        )
        with self._transactions.writing() as connection:
            if lock_job(connection, claim.job_id) is None:
                return
            last = connection.execute(lost).one_or_none()
            if last is None or last.problem["code"] != WORKER_LOST:
                return
            if connection.execute(restore).rowcount == 1:
                connection.execute(delete(failures).where(failures.c.id == last.id))


def _locked(connection: Connection, job_ids: list[str]) -> list[Row[Any]]:
    """Lock jobs one after another, and return those that still exist."""
    return [job for job_id in job_ids if (job := lock_job(connection, job_id)) is not None]
