"""Keys of the service: each belongs to a tenant, and has scopes. A browser that has shown a key gets a cookie."""

import hashlib
import secrets
from collections.abc import Collection

from sqlalchemy import ColumnElement, Connection, delete, insert, select, update
from uuid_utils import uuid7

from worker.store.database.access import ServiceRepository, existing
from worker.store.database.connection import now
from worker.store.database.rows import read
from worker.store.database.tables import browser_sessions, keys
from worker.store.model.rights import Actor, Key, Scope
from worker.store.repositories.audit import AuditAction, record_event

_PREFIX = "mc_"

# Of keys and cookies. Long enough that a digest without salt is safe: the secret can't be guessed.
_SECRET_BYTES = 32


class Keys(ServiceRepository):
    """Keys of all tenants. Secrets are not stored, only their SHA-256."""

    def add(
        self, tenant: str, name: str, scopes: Collection[Scope], lifetime_s: float | None = None
    ) -> tuple[Key, str]:
        """Make a key; returns it with its secret, which can't be read again.

        It expires after ``lifetime_s``; ``None``: it is valid until it is revoked.
        """
        key_id, secret = str(uuid7()), _PREFIX + secrets.token_urlsafe(_SECRET_BYTES)
        with self._transactions.writing() as connection:
            connection.execute(
                insert(keys).values(
                    id=key_id,
                    tenant=tenant,
                    name=name,
                    scopes=sorted(scopes),
                    sha256=digest(secret),
                    created_at=now(),
                    expires_at=None if lifetime_s is None else now() + lifetime_s,
                )
            )
            record_event(connection, Actor(), tenant, AuditAction.KEY_CREATED, key_id)
            return read(Key, connection.execute(select(keys).where(keys.c.id == key_id)).one()), secret

    def all(self) -> list[Key]:
        """All keys, also those that are no longer valid, the oldest first."""
        with self._transactions.reading() as connection:
            return [read(Key, row) for row in connection.execute(select(keys).order_by(keys.c.id))]

    def count_tenants(self) -> int:
        """Number of tenants that have a valid key with the scope ``write``."""
        with self._transactions.reading() as connection:
            return count_tenants(connection)

    def exist(self) -> bool:
        """True if a key was ever made: from then on every request needs one."""
        with self._transactions.reading() as connection:
            return connection.execute(select(keys.c.id).limit(1)).first() is not None

    def revoke(self, key_id: str) -> Key:
        """Revoke a key for good, with the browser sessions that it opened; revoking twice is no error.

        Raises ``NotFound``.
        """
        with self._transactions.writing() as connection:
            row = existing(
                connection.execute(select(keys).where(keys.c.id == key_id).with_for_update()).one_or_none(), "key"
            )
            if row.revoked_at is None:
                connection.execute(update(keys).where(keys.c.id == key_id).values(revoked_at=now()))
                connection.execute(delete(browser_sessions).where(browser_sessions.c.key_id == key_id))
                record_event(connection, Actor(), row.tenant, AuditAction.KEY_REVOKED, key_id)
            return read(Key, connection.execute(select(keys).where(keys.c.id == key_id)).one())

    def find(self, secret: str) -> Key | None:
        """Key with a secret; ``None`` if it is unknown or not valid now."""
        if not secret.startswith(_PREFIX):
            return None
        query = select(keys).where(keys.c.sha256 == digest(secret), is_valid())
        with self._transactions.reading() as connection:
            row = connection.execute(query).one_or_none()
        return None if row is None else read(Key, row)

    def valid(self, key_ids: Collection[str]) -> set[str]:
        """Ids among some whose keys are valid now."""
        query = select(keys.c.id).where(keys.c.id.in_(key_ids), is_valid())
        with self._transactions.reading() as connection:
            return set(connection.scalars(query))


def count_tenants(connection: Connection) -> int:
    """Number of tenants that have a valid key with the scope ``write``."""
    rows = connection.execute(select(keys.c.tenant, keys.c.scopes).where(is_valid()))
    return len({row.tenant for row in rows if Scope.WRITE in row.scopes})


def digest(secret: str) -> str:
    """SHA-256 of a secret."""
    return hashlib.sha256(secret.encode(errors="surrogateescape")).hexdigest()


def is_valid() -> ColumnElement[bool]:
    """Condition that a key is neither revoked nor expired."""
    return keys.c.revoked_at.is_(None) & (keys.c.expires_at.is_(None) | (keys.c.expires_at > now()))


class BrowserSessions(ServiceRepository):
    """Browser sessions of all tenants. Secrets are not stored, only their SHA-256."""

    def open(self, key: Key, lifetime_s: float, request_id: str | None = None) -> str:
        """Open a session for a browser that has shown a key; returns its secret."""
        secret = secrets.token_urlsafe(_SECRET_BYTES)
        with self._transactions.writing() as connection:
            connection.execute(delete(browser_sessions).where(browser_sessions.c.expires_at < now()))
            connection.execute(
                insert(browser_sessions).values(sha256=digest(secret), key_id=key.id, expires_at=now() + lifetime_s)
            )
            record_event(connection, Actor(key.id, request_id), key.tenant, AuditAction.BROWSER_LET_IN, key.id)
        return secret

    def find(self, secret: str) -> Key | None:
        """Key that a browser has shown; ``None`` unless both the session and the key are valid now."""
        query = (
            select(keys)
            .join(browser_sessions)
            .where(browser_sessions.c.sha256 == digest(secret), browser_sessions.c.expires_at > now(), is_valid())
        )
        with self._transactions.reading() as connection:
            row = connection.execute(query).one_or_none()
        return None if row is None else read(Key, row)

    def close(self, secret: str) -> None:
        """Delete a session."""
        with self._transactions.writing() as connection:
            connection.execute(delete(browser_sessions).where(browser_sessions.c.sha256 == digest(secret)))
