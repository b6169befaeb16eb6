"""Files that nobody needs any more: noted with what makes them so, removed soon after.

Whoever dies between the two loses nothing: the reaper looks for what is due.
"""

from datetime import timedelta

import structlog
from sqlalchemy import Connection, delete, insert, select
from uuid_utils import uuid7

from worker.jobs.database.connection import Database, now
from worker.jobs.database.tables import jobs, removals
from worker.jobs.database.transitions import lock_job, move_job
from worker.jobs.files.artifacts import ArtifactStore, job_prefix, session_prefix
from worker.jobs.model import JobState, Removal

# A session's files take less to be put into the artifact store: what is not recorded by then never will be.
_ARRIVAL = timedelta(days=1)
# A worker that was frozen while its job was deleted may still write afterwards: look again when none can be left.
_AGAIN_AFTER = timedelta(hours=2)

log = structlog.get_logger()


def remove_later(connection: Connection, prefix: str) -> None:
    """Note files to be removed after the transaction."""
    for wait_s in (0.0, _AGAIN_AFTER.total_seconds()):
        connection.execute(insert(removals).values(prefix=prefix, due_at=now() + wait_s))


def keep(connection: Connection, prefix: str) -> bool:
    """Forget that files were to be removed; ``False`` if they are gone already."""
    return connection.execute(delete(removals).where(removals.c.prefix == prefix)).rowcount > 0


class Removals:
    """The store's list of files that have to go."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def announce_session(self) -> str:
        """Make the id of a session whose files are about to come; they go after a day unless it is recorded."""
        session_id = str(uuid7())
        due_at = now() + _ARRIVAL.total_seconds()
        with self._database.writing() as connection:
            connection.execute(insert(removals).values(prefix=session_prefix(session_id), due_at=due_at))
        return session_id

    def expire(self) -> list[str]:
        """Say of jobs whose time is over that their results are gone, and note these for removal; those jobs' ids."""
        due = select(jobs.c.id).where(jobs.c.expires_at < now(), jobs.c.state != JobState.EXPIRED)
        with self._database.reading() as connection:
            found = connection.scalars(due.order_by(jobs.c.id)).all()
        expired = []
        for job_id in found:
            with self._database.writing() as connection:
                lock_job(connection, job_id)
                # Again: it may have been deleted, or have gone through another attempt, while we waited for the lock.
                if connection.scalar(due.where(jobs.c.id == job_id)) is not None:
                    move_job(connection, job_id, JobState.EXPIRED)
                    remove_later(connection, job_prefix(job_id))
                    expired.append(job_id)
        return expired

    def removals(self) -> list[Removal]:
        """What is due, the oldest first."""
        query = select(removals.c.id, removals.c.prefix).where(removals.c.due_at < now()).order_by(removals.c.id)
        with self._database.reading() as connection:
            return [Removal(row.id, row.prefix) for row in connection.execute(query)]

    def removed(self, removal_id: int) -> None:
        """Say that a removal was carried out."""
        with self._database.writing() as connection:
            connection.execute(delete(removals).where(removals.c.id == removal_id))


def remove_files(store: Removals, artifacts: ArtifactStore) -> None:
    """Remove what is due. What can't be removed now stays due; the log says why."""
    for removal in store.removals():
        try:
            artifacts.delete_prefix(removal.prefix)
        except OSError:
            log.exception("removal_failed", prefix=removal.prefix)
        else:
            store.removed(removal.id)
