"""Removals: files of the artifact store that are not needed any more, by a prefix of their keys or one key.

A removal is noted in the transaction that makes the files superfluous, and carried out after it. A process that is
killed in between loses nothing: the reaper looks for removals that are due.
"""

from sqlalchemy import delete, select

from worker.jobs.database.connection import now
from worker.jobs.database.removal_notes import remove_later
from worker.jobs.database.tables import jobs, removals
from worker.jobs.database.transactions import Transactions
from worker.jobs.database.transitions import delete_visuals_job, lock_job, move_job
from worker.jobs.files.artifacts import job_prefix
from worker.jobs.model.states import JobState
from worker.jobs.model.work import Removal


class Removals:
    """Removals of all tenants."""

    def __init__(self, transactions: Transactions) -> None:
        self._transactions = transactions

    def expire_jobs(self) -> list[str]:
        """Expire the jobs whose retention time is over, and note their results for removal; returns the jobs' ids."""
        due = select(jobs.c.id).where(jobs.c.expires_at < now(), jobs.c.state != JobState.EXPIRED)
        with self._transactions.reading() as connection:
            found = connection.scalars(due.order_by(jobs.c.id)).all()
        expired = []
        for job_id in found:
            with self._transactions.writing() as connection:
                lock_job(connection, job_id)
                # Again: the job may have been deleted or retried before it was locked.
                if connection.scalar(due.where(jobs.c.id == job_id)) is not None:
                    move_job(connection, job_id, JobState.EXPIRED)
                    delete_visuals_job(connection, job_id)
                    remove_later(connection, job_prefix(job_id))
                    expired.append(job_id)
        return expired

    def due(self) -> list[Removal]:
        """Removals that are due, the oldest first."""
        query = select(removals.c.id, removals.c.prefix).where(removals.c.due_at <= now()).order_by(removals.c.id)
        with self._transactions.reading() as connection:
            return [Removal(row.id, row.prefix) for row in connection.execute(query)]

    def done(self, removal_id: int) -> None:
        """Delete a removal that was carried out."""
        with self._transactions.writing() as connection:
            connection.execute(delete(removals).where(removals.c.id == removal_id))
