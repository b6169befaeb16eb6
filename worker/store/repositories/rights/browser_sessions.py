"""Browser sessions: a browser that has shown a key gets a cookie with a secret of its own."""

import secrets

from sqlalchemy import delete, insert, select

from worker.store.database.connection import now
from worker.store.database.tables import browser_sessions, keys
from worker.store.database.transactions import Transactions
from worker.store.model.rights import Actor, Key
from worker.store.repositories.audit import AuditAction, record_event
from worker.store.repositories.rights.keys import digest, is_valid, key_of

_SECRET_BYTES = 32


class BrowserSessions:
    """Browser sessions of all tenants. Secrets are not stored, only their SHA-256."""

    def __init__(self, transactions: Transactions) -> None:
        self._transactions = transactions

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
        return None if row is None else key_of(row)

    def close(self, secret: str) -> None:
        """Delete a session."""
        with self._transactions.writing() as connection:
            connection.execute(delete(browser_sessions).where(browser_sessions.c.sha256 == digest(secret)))
