"""What all of a tenant's records share: whose they are, how much the tenant may have, who acts."""

from sqlalchemy import ColumnElement, Connection, Table, true

from worker.jobs.database.connection import Database, lock
from worker.jobs.database.quotas import NO_QUOTAS, Quotas, read_usage, require_room
from worker.jobs.database.tables import DEFAULT_TENANT
from worker.jobs.model import Actor

_COMMAND_LINE = Actor()


class OfTenant:
    """Base of a tenant's records.

    Parameters
    ----------
    tenant
        Whose these are: another's are not there. ``None``: everybody's.
    quotas
        How much the tenant may have.
    actor
        Who does what is done here.
    """

    def __init__(
        self,
        database: Database,
        tenant: str | None = None,
        quotas: Quotas = NO_QUOTAS,
        actor: Actor = _COMMAND_LINE,
    ) -> None:
        self._database = database
        self._tenant = tenant
        self._quotas = quotas
        self._actor = actor

    @property
    def _owner(self) -> str:
        """Whose that is which is made here."""
        return self._tenant or DEFAULT_TENANT

    def _mine(self, table: Table) -> ColumnElement[bool]:
        return true() if self._tenant is None else table.c.tenant == self._tenant

    def _require_room(self, connection: Connection, **more: int) -> None:
        if self._quotas == NO_QUOTAS:
            return
        lock(connection, f"quotas of {self._owner}")  # so that two at once don't each take the last place
        require_room(self._quotas, read_usage(connection, self._owner), **more)
