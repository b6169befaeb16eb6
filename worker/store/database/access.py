"""Access of repositories to the database: transactions, the tenant, its quotas, and the actor for the audit.

Each call of a repository begins its own transaction, or all calls join one that is open.
"""

import contextlib
from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from sqlalchemy import ColumnElement, Connection, Select, Table, true

from worker.store.database.connection import lock
from worker.store.database.quotas import NO_QUOTAS, Quotas, read_unfinished, read_usage, require_room
from worker.store.errors import NotFound
from worker.store.model.phone_records import UploadingPhone
from worker.store.model.rights import DEFAULT_TENANT, Actor

T = TypeVar("T")


class Transactions(Protocol):
    """Source of transactions: ``Database`` begins one for each block, ``OpenTransaction`` lends the one it has."""

    def reading(self) -> AbstractContextManager[Connection]:
        """Transaction that reads."""

    def writing(self) -> AbstractContextManager[Connection]:
        """Transaction that writes."""


@dataclass(frozen=True, slots=True)
class OpenTransaction:
    """A transaction that writes and is open already; the block that began it commits it or rolls it back."""

    connection: Connection

    @contextlib.contextmanager
    def writing(self) -> Iterator[Connection]:
        """Lend the connection."""
        yield self.connection

    reading = writing


_COMMAND_LINE = Actor()


@dataclass(frozen=True, slots=True)
class Access:
    """Access to the rows of one tenant, or of all tenants."""

    transactions: Transactions  # Database, or one open transaction that all repositories share
    tenant: str | None = None  # Tenant whose rows can be reached; ``None``: all tenants
    quotas: Quotas = NO_QUOTAS  # Limits of the tenant
    actor: Actor = _COMMAND_LINE  # Key and request that are written to the audit
    phone: UploadingPhone | None = None  # Phone whose uploads alone can be reached; ``None``: all uploads

    @property
    def owner(self) -> str:
        """Tenant that owns new rows."""
        return self.tenant or DEFAULT_TENANT

    def reading(self) -> AbstractContextManager[Connection]:
        """Transaction that reads."""
        return self.transactions.reading()

    def writing(self) -> AbstractContextManager[Connection]:
        """Transaction that writes."""
        return self.transactions.writing()

    def may_reach(self, table: Table) -> ColumnElement[bool]:
        """Condition that a row of a table belongs to the tenant."""
        return true() if self.tenant is None else table.c.tenant == self.tenant

    def require_room(self, connection: Connection, **more: int) -> None:
        """Raise ``QuotaExceeded`` if the owner may not have so much more; the answer holds until the transaction ends.

        ``more`` are amounts by the names of ``Quotas``.
        """
        if self.quotas == NO_QUOTAS:
            return
        lock(connection, f"quotas of {self.owner}")  # two requests at once must not both take the last place
        read = read_unfinished if more.keys() == {"unfinished_jobs"} else read_usage
        require_room(self.quotas, read(connection, self.owner), **more)


class ServiceRepository:
    """Rows of the whole service, whatever their tenants."""

    def __init__(self, transactions: Transactions) -> None:
        self._transactions = transactions


class Repository:
    """Rows that are reached by an ``Access``."""

    def __init__(self, access: Access) -> None:
        self._access = access


def existing(row: T | None, name: str) -> T:
    """Return what a query found; ``NotFound`` if that is nothing."""
    if row is None:
        raise NotFound(f"There is no such {name}.")
    return row


def newest_first(query: Select[Any], table: Table, limit: int, after: str | None = None) -> Select[Any]:
    """Page of a query, ordered by the ids of a table; ``after`` is the last id of the page before."""
    query = query.order_by(table.c.id.desc()).limit(limit)
    return query if after is None else query.where(table.c.id < after)
