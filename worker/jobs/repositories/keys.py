"""Keys: who may use the service, as which tenant, and for what."""

import hashlib
import secrets
from collections.abc import Collection
from typing import Any

from sqlalchemy import Connection, Row, delete, insert, or_, select, update
from uuid_utils import uuid7

from worker.jobs.database.connection import Database, now
from worker.jobs.database.tables import browser_sessions, keys
from worker.jobs.errors import NotFound
from worker.jobs.model import Actor, Key, Scope
from worker.jobs.repositories.audit import Act, note_deed

_PREFIX = "mc_"

# Enough that a digest without salt is safe: nobody guesses it.
_SECRET_BYTES = 32


class Keys:
    """The store's keys. Secrets are never kept, only their SHA-256."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def create_key(
        self, tenant: str, name: str, scopes: Collection[Scope], lifetime_s: float | None = None
    ) -> tuple[Key, str]:
        """Make a key; returns it with its secret, which can't be read again.

        Parameters
        ----------
        lifetime_s
            How long it is valid; ``None``: until it is revoked.
        """
        key_id, secret = str(uuid7()), _PREFIX + secrets.token_urlsafe(_SECRET_BYTES)
        with self._database.writing() as connection:
            connection.execute(
                insert(keys).values(
                    id=key_id,
                    tenant=tenant,
                    name=name,
                    scopes=sorted(scopes),
                    sha256=_digest(secret),
                    created_at=now(),
                    expires_at=None if lifetime_s is None else now() + lifetime_s,
                )
            )
            note_deed(connection, Actor(), tenant, Act.KEY_CREATED, key_id)
            return _key(connection.execute(select(keys).where(keys.c.id == key_id)).one()), secret

    def list_keys(self) -> list[Key]:
        """All keys, also those that are no longer valid, the oldest first."""
        with self._database.reading() as connection:
            return [_key(row) for row in connection.execute(select(keys).order_by(keys.c.id))]

    def count_tenants(self) -> int:
        """Number of tenants that have a valid key to make jobs with."""
        with self._database.reading() as connection:
            return count_tenants(connection)

    def has_keys(self) -> bool:
        """Whether there ever was a key: from then on nobody comes in without one."""
        with self._database.reading() as connection:
            return connection.execute(select(keys.c.id).limit(1)).first() is not None

    def revoke_key(self, key_id: str) -> Key:
        """End a key for good, and every browser session that it opened; revoking twice is no error.

        Raises
        ------
        NotFound
        """
        with self._database.writing() as connection:
            row = connection.execute(select(keys).where(keys.c.id == key_id).with_for_update()).one_or_none()
            if row is None:
                raise NotFound("There is no such key.")
            if row.revoked_at is None:
                connection.execute(update(keys).where(keys.c.id == key_id).values(revoked_at=now()))
                connection.execute(delete(browser_sessions).where(browser_sessions.c.key_id == key_id))
                note_deed(connection, Actor(), row.tenant, Act.KEY_REVOKED, key_id)
            return _key(connection.execute(select(keys).where(keys.c.id == key_id)).one())

    def find_key(self, secret: str) -> Key | None:
        """The key with a secret, if it is valid now."""
        if not secret.startswith(_PREFIX):
            return None
        query = select(keys).where(keys.c.sha256 == _digest(secret), _is_valid())
        with self._database.reading() as connection:
            row = connection.execute(query).one_or_none()
        return None if row is None else _key(row)

    def valid_keys(self, key_ids: Collection[str]) -> set[str]:
        """Those of some keys, by their ids, that are valid now."""
        query = select(keys.c.id).where(keys.c.id.in_(key_ids), _is_valid())
        with self._database.reading() as connection:
            return set(connection.scalars(query))

    def open_browser_session(self, key: Key, lifetime_s: float, request_id: str | None = None) -> str:
        """Let a browser in that has shown a key; returns a secret of its own, for a cookie."""
        secret = secrets.token_urlsafe(_SECRET_BYTES)
        with self._database.writing() as connection:
            connection.execute(delete(browser_sessions).where(browser_sessions.c.expires_at < now()))
            connection.execute(
                insert(browser_sessions).values(sha256=_digest(secret), key_id=key.id, expires_at=now() + lifetime_s)
            )
            note_deed(connection, Actor(key.id, request_id), key.tenant, Act.BROWSER_LET_IN, key.id)
        return secret

    def find_browser_session(self, secret: str) -> Key | None:
        """The key that a browser has shown, if both are valid now."""
        query = (
            select(keys)
            .join(browser_sessions)
            .where(browser_sessions.c.sha256 == _digest(secret), browser_sessions.c.expires_at > now(), _is_valid())
        )
        with self._database.reading() as connection:
            row = connection.execute(query).one_or_none()
        return None if row is None else _key(row)

    def close_browser_session(self, secret: str) -> None:
        """Forget a browser."""
        with self._database.writing() as connection:
            connection.execute(delete(browser_sessions).where(browser_sessions.c.sha256 == _digest(secret)))


def count_tenants(connection: Connection) -> int:
    """Number of tenants that have a valid key to make jobs with."""
    valid = keys.c.revoked_at.is_(None) & or_(keys.c.expires_at.is_(None), keys.c.expires_at > now())
    rows = connection.execute(select(keys.c.tenant, keys.c.scopes).where(valid))
    return len({row.tenant for row in rows if Scope.WRITE in row.scopes})


def _digest(secret: str) -> str:
    return hashlib.sha256(secret.encode(errors="surrogateescape")).hexdigest()


def _is_valid() -> Any:
    return keys.c.revoked_at.is_(None) & (keys.c.expires_at.is_(None) | (keys.c.expires_at > now()))


def _key(row: Row[Any]) -> Key:
    return Key(
        id=row.id,
        tenant=row.tenant,
        name=row.name,
        scopes=frozenset(Scope(scope) for scope in row.scopes),
        created_at=row.created_at,
        expires_at=row.expires_at,
        revoked_at=row.revoked_at,
    )
