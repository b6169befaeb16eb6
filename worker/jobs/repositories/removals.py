"""Removals: files of the artifact store that are not needed any more, by their keys' prefix.

A removal is noted in the transaction that makes the files superfluous, and carried out after it. A process that is
killed in between loses nothing: the reaper looks for removals that are due.
"""

from datetime import timedelta

from sqlalchemy import Connection, delete, insert, select

from worker.jobs.database.connection import now
from worker.jobs.database.tables import jobs, removals
from worker.jobs.database.transactions import Transactions
from worker.jobs.database.transitions import lock_job, move_job
from worker.jobs.files.artifacts import job_prefix
from worker.jobs.model import JobState, Removal

# Files of a session take less than this to reach the artifact store; a session that is not added by then never is.
_ARRIVAL = timedelta(days=1)
# A worker that was frozen while its job was deleted may still write: look again when no such worker can be left.
_AGAIN_AFTER = timedelta(hours=2)


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


def remove_later(connection: Connection, prefix: str) -> None:
    """Note files to be removed after the transaction."""
    for wait_s in (0.0, _AGAIN_AFTER.total_seconds()):
        connection.execute(insert(removals).values(prefix=prefix, due_at=now() + wait_s))


def remove_unless_kept(connection: Connection, prefix: str) -> None:
    """Note files that are about to be stored to be removed after a day, unless ``keep`` is called before."""
    connection.execute(insert(removals).values(prefix=prefix, due_at=now() + _ARRIVAL.total_seconds()))


def keep(connection: Connection, prefix: str) -> bool:
    """Delete the removals of some files; ``False`` if the files are removed already."""
    return connection.execute(delete(removals).where(removals.c.prefix == prefix)).rowcount > 0
