"""Secrets of the links by which phones join recordings.

A link ends with its recording, with the key that made it, and when another link is made. Its secret is not stored, only
its SHA-256.
"""

from collections.abc import Collection
from typing import Any

from sqlalchemy import ColumnElement, Select, or_, select

from worker.store.database.connection import now
from worker.store.database.tables import keys, recordings
from worker.store.database.transactions import Transactions
from worker.store.model.recordings import JoinLink
from worker.store.repositories.rights.keys import digest, is_valid
from worker.store.repositories.rights.links import LINK_PREFIX


class JoinSecrets:
    """Secrets of the links of all recordings, for requests and WebSockets that bring one."""

    def __init__(self, transactions: Transactions) -> None:
        self._transactions = transactions

    def find(self, secret: str) -> JoinLink | None:
        """Link with a secret; ``None`` if it is unknown or has ended."""
        if not secret.startswith(LINK_PREFIX):
            return None
        query = _select(recordings.c.join_id, recordings.c.id, recordings.c.tenant)
        with self._transactions.reading() as connection:
            row = connection.execute(query.where(recordings.c.join_sha256 == digest(secret))).one_or_none()
        return None if row is None else JoinLink(row.join_id, row.id, row.tenant)

    def valid(self, link_ids: Collection[str]) -> set[str]:
        """Ids among some whose links are valid now."""
        query = _select(recordings.c.join_id).where(recordings.c.join_id.in_(link_ids))
        with self._transactions.reading() as connection:
            return set(connection.scalars(query))


def _select(*columns: ColumnElement[Any]) -> Select[Any]:
    """Columns of recordings whose links are valid; a link that no key made ends with the first key."""
    has_no_keys = ~select(keys.c.id).correlate(None).exists()
    by_key = or_(keys.c.id.is_not(None) & is_valid(), recordings.c.join_key_id.is_(None) & has_no_keys)
    joined = recordings.outerjoin(keys, keys.c.id == recordings.c.join_key_id)
    return select(*columns).select_from(joined).where(recordings.c.expires_at > now(), by_key)
