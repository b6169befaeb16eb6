"""The job store: one repository for each resource, on one database."""

from contextlib import AbstractContextManager

from sqlalchemy import select
from sqlalchemy.exc import SQLAlchemyError

from worker.store.database.access import Access
from worker.store.database.connection import Database
from worker.store.database.quotas import NO_QUOTAS, Quotas
from worker.store.database.tables import sessions
from worker.store.database.totals import read_figures
from worker.store.model.phone_records import UploadingPhone
from worker.store.model.rights import Actor
from worker.store.model.work import Figures
from worker.store.repositories.audit import Audit
from worker.store.repositories.keys import BrowserSessions, Keys
from worker.store.repositories.links import JoinSecrets, LinkSecrets
from worker.store.repositories.webhooks import Webhooks, WebhookSecrets
from worker.store.repositories.work.expiry import Removals
from worker.store.repositories.work.leases import MAX_ATTEMPTS, Leases
from worker.store.repositories.work.plans import Outputs, Plans
from worker.store.repositories.work.workers import Waits, Workers
from worker.store.tenant_records import Records, TenantRecords

__all__ = ["MAX_ATTEMPTS", "JobStore"]

_NOBODY = Actor()


class JobStore(Records):
    """Repositories of sessions, jobs and all that belongs to them, of all tenants.

    Every method of a repository is one transaction. A store may be shared by threads and carried across a fork.
    ``database_url`` is SQLAlchemy's, of a SQLite file or of PostgreSQL.
    """

    def __init__(self, database_url: str) -> None:
        self._database = Database(database_url)
        super().__init__(Access(self._database))
        # Of the workers.
        self.leases = Leases(self._database)
        self.waits = Waits(self._database)
        self.outputs = Outputs(self._database)
        self.workers = Workers(self._database)
        # Of the reaper.
        self.plans = Plans(self._database)
        self.removals = Removals(self._database)
        self.webhooks = Webhooks(self._database)
        # Of the operator.
        self.keys = Keys(self._database)
        self.browser_sessions = BrowserSessions(self._database)
        self.link_secrets = LinkSecrets(self._database)
        self.join_secrets = JoinSecrets(self._database)
        self.webhook_secrets = WebhookSecrets(self._database)
        self.audit = Audit(self._database)

    def tenant(
        self, tenant: str, quotas: Quotas = NO_QUOTAS, actor: Actor = _NOBODY, phone: UploadingPhone | None = None
    ) -> TenantRecords:
        """Records of one tenant. ``actor`` is the key and the request that are written to the audit.

        A ``phone`` reaches the uploads that it sent, and no others.
        """
        return TenantRecords(Access(self._database, tenant, quotas, actor, phone))

    def transaction(
        self, tenant: str, quotas: Quotas = NO_QUOTAS, actor: Actor = _NOBODY
    ) -> AbstractContextManager[TenantRecords]:
        """Records of one tenant, all in one transaction; see ``TenantRecords.transaction``.

        >>> with store.transaction("studio") as work:  # doctest: +SKIP
        ...     session = work.sessions.add(name, files, preflight, session_id)
        ...     job = work.jobs.add(session.id, spec, stages)
        """
        return self.tenant(tenant, quotas, actor).transaction()

    def figures(self) -> Figures:
        """Figures of all jobs, for monitoring."""
        with self._database.reading() as connection:
            return read_figures(connection)

    def migrate(self) -> None:
        """Bring the schema up to date, as ``Database.migrate`` does."""
        self._database.migrate()

    def require_whole(self) -> None:
        """Raise ``DamagedDatabase`` if the database is damaged, as ``Database.require_whole`` does."""
        self._database.require_whole()

    @property
    def is_damaged(self) -> bool:
        """True if the database was found damaged."""
        return self._database.is_damaged

    def require_known_schema(self) -> None:
        """Raise ``UnknownSchema`` if this version does not know the database's schema."""
        self._database.require_known_schema()

    def ping(self) -> bool:
        """True if the database answers, and has the schema."""
        try:
            with self._database.reading() as connection:
                connection.execute(select(sessions.c.id).limit(1))
        except SQLAlchemyError:
            return False
        return True

    def close(self) -> None:
        """Close the connections that are not in use."""
        self._database.close()
