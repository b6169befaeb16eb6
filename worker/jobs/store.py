"""The job store: what is to be done, who does it, and what came of it."""

from sqlalchemy import select
from sqlalchemy.exc import SQLAlchemyError

from worker.jobs.database.connection import Database
from worker.jobs.database.quotas import Quotas
from worker.jobs.database.tables import sessions
from worker.jobs.database.totals import read_figures
from worker.jobs.files.removals import Removals
from worker.jobs.model import Actor, Figures
from worker.jobs.repositories.audit import Audit
from worker.jobs.repositories.deliveries import Deliveries
from worker.jobs.repositories.keys import Keys
from worker.jobs.repositories.leases import MAX_ATTEMPTS, Leases
from worker.jobs.repositories.plans import Plans
from worker.jobs.repositories.records import Records
from worker.jobs.repositories.workers import Workers

__all__ = ["MAX_ATTEMPTS", "JobStore"]


class JobStore(Records, Leases, Plans, Removals, Deliveries, Keys, Audit, Workers):
    """Sessions, jobs and chunks in a database.

    ``Records`` for clients, here of all tenants, ``Leases`` for workers, ``Plans`` after an upgrade, ``Removals`` of
    files, ``Deliveries`` of webhooks, ``Keys``, ``Audit`` and ``Workers``.

    Every method is one transaction. A store may be shared by threads and carried across a fork.

    Parameters
    ----------
    database_url
        SQLAlchemy URL of a SQLite file or of PostgreSQL.
    """

    def __init__(self, database_url: str) -> None:
        super().__init__(Database(database_url))

    def migrate(self) -> None:
        """Bring the schema up to date, as ``Database.migrate`` does."""
        self._database.migrate()

    def figures(self) -> Figures:
        """What monitoring wants to know of all jobs."""
        with self._database.reading() as connection:
            return read_figures(connection)

    def of(self, tenant: str, quotas: Quotas, actor: Actor) -> Records:
        """The clients' side, of one tenant."""
        return Records(self._database, tenant, quotas, actor)

    def require_whole(self) -> None:
        """Raise ``DamagedDatabase`` if the database is damaged, as ``Database.require_whole`` does."""
        self._database.require_whole()

    @property
    def is_damaged(self) -> bool:
        """Whether the database was found damaged."""
        return self._database.is_damaged

    def require_known_schema(self) -> None:
        """Raise ``NewerDatabase`` if the database is of a newer version of Multicap."""
        self._database.require_known_schema()

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
