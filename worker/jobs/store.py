"""The job store: what is to be done, who does it, and what came of it."""

from sqlalchemy import select
from sqlalchemy.exc import SQLAlchemyError

from worker.jobs.database import Database
from worker.jobs.leases import MAX_ATTEMPTS, Leases
from worker.jobs.records import Records
from worker.jobs.tables import sessions

__all__ = ["MAX_ATTEMPTS", "JobStore"]


class JobStore(Records, Leases):
    """Sessions, jobs and chunks in a database: ``Records`` for clients, ``Leases`` for workers.

    Every method is one transaction. A store may be shared by threads and carried across a fork.

    Parameters
    ----------
    database_url
        SQLAlchemy URL of a SQLite file or of PostgreSQL.
    """

    def __init__(self, database_url: str) -> None:
        super().__init__(Database(database_url))

    def migrate(self) -> None:
        """Bring the schema up to date; several processes may try at once."""
        self._database.migrate()

    def ping(self) -> bool:
        """Whether the database answers, and has the schema."""
        try:
            with self._database.reading() as connection:
                connection.execute(select(sessions.c.id).limit(1))
        except SQLAlchemyError:
            return False
        return True

    def close(self) -> None:
        """Close the connections that are not in use."""
        self._database.close()
