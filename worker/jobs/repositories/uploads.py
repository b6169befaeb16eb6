"""Uploads: files that clients send in pieces, until a session takes them or they expire.

A row holds what was announced. The number of bytes that have arrived is the size of the file on the spool of the API
that receives it.
"""

from collections.abc import Collection
from typing import Any

from sqlalchemy import Connection, Row, delete, insert, select, update

from worker.jobs.database.access import Access
from worker.jobs.database.connection import now
from worker.jobs.database.tables import uploads
from worker.jobs.errors import Conflict, NotFound
from worker.jobs.model.sessions import Upload
from worker.jobs.repositories.audit import AuditAction, record_event


class Uploads:
    """Uploads of a tenant, or of all tenants. An expired upload is treated as unknown."""

    def __init__(self, access: Access) -> None:
        self._access = access

    def add(self, upload_id: str, name: str, num_bytes: int, metadata: str, keep_s: float, spool: str) -> Upload:
        """Add an upload; its bytes count for the tenant's quota from now on.

        Parameters
        ----------
        upload_id
            Name of its file on the spool.
        name
            Name that the client gave the file.
        num_bytes
            Size of the complete file.
        metadata
            Text of the client, stored as it is.
        keep_s
            Time until it expires; begins again with each ``renew``.
        spool
            Host and folder that hold its bytes.

        Raises
        ------
        QuotaExceeded
        """
        access = self._access
        with access.writing() as connection:
            access.require_room(connection, uploads=1, stored_bytes=num_bytes)
            connection.execute(
                insert(uploads).values(
                    id=upload_id,
                    tenant=access.owner,
                    name=name,
                    num_bytes=num_bytes,
                    metadata=metadata,
                    expires_at=now() + keep_s,
                    spool=spool,
                )
            )
            record_event(connection, access.actor, access.owner, AuditAction.UPLOAD_CREATED, upload_id)
            return self._read(connection, upload_id)

    def get(self, upload_id: str) -> Upload:
        """Upload with an id; ``NotFound`` if there is none."""
        with self._access.reading() as connection:
            return self._read(connection, upload_id)

    def renew(self, upload_id: str, keep_s: float) -> Upload:
        """Keep an upload for longer; ``NotFound`` if there is none."""
        with self._access.writing() as connection:
            self._read(connection, upload_id)
            connection.execute(update(uploads).where(uploads.c.id == upload_id).values(expires_at=now() + keep_s))
            return self._read(connection, upload_id)

    def delete(self, upload_id: str) -> None:
        """Delete an upload; ``NotFound`` if there is none."""
        access = self._access
        with access.writing() as connection:
            self._read(connection, upload_id)
            connection.execute(delete(uploads).where(uploads.c.id == upload_id))
            record_event(connection, access.actor, access.owner, AuditAction.UPLOAD_DELETED, upload_id)

    def use(self, upload_ids: Collection[str]) -> None:
        """Delete uploads whose files a session of the same transaction takes.

        Call it before the session is added, so that no byte counts twice for the quota. Raises ``Conflict`` if one of
        the uploads is unknown.
        """
        if not upload_ids:
            return
        chosen = delete(uploads).where(self._access.may_reach(uploads), uploads.c.id.in_(upload_ids))
        with self._access.writing() as connection:
            if connection.execute(chosen).rowcount != len(upload_ids):
                raise Conflict("An upload was deleted, or used for another session, in the meantime.")

    def expired(self) -> list[str]:
        """Ids of expired uploads."""
        query = select(uploads.c.id).where(self._access.may_reach(uploads), uploads.c.expires_at < now())
        with self._access.reading() as connection:
            return list(connection.scalars(query))

    def delete_expired(self, upload_id: str) -> None:
        """Delete an upload unless it was renewed in the meantime."""
        with self._access.writing() as connection:
            connection.execute(delete(uploads).where(uploads.c.id == upload_id, uploads.c.expires_at < now()))

    def known(self, upload_ids: Collection[str]) -> set[str]:
        """Ids among some that belong to an upload, expired or not."""
        query = select(uploads.c.id).where(self._access.may_reach(uploads), uploads.c.id.in_(upload_ids))
        with self._access.reading() as connection:
            return set(connection.scalars(query))

    def _read(self, connection: Connection, upload_id: str) -> Upload:
        mine = self._access.may_reach(uploads)
        query = select(uploads).where(uploads.c.id == upload_id, mine, uploads.c.expires_at >= now())
        row = connection.execute(query).one_or_none()
        if row is None:
            raise NotFound("There is no such upload.")
        return _upload_of(row)


def _upload_of(row: Row[Any]) -> Upload:
    return Upload(row.id, row.name, row.num_bytes, row.metadata, row.expires_at, row.spool)
