"""Uploads: files that clients send in pieces, until a session takes them or they expire.

A row holds the announcement. The number of bytes that have arrived is the size of the file on the spool of the API
that receives it.
"""

from collections.abc import Collection

from sqlalchemy import ColumnElement, Connection, delete, func, insert, select, update

from worker.store.database.access import Access
from worker.store.database.connection import lock, now
from worker.store.database.rows import read
from worker.store.database.tables import uploads
from worker.store.errors import Conflict, NotFound
from worker.store.model.phone_records import UploadingPhone
from worker.store.model.session_records import Upload
from worker.store.repositories.audit import AuditAction, record_event


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
        Conflict
            The phones of a recording have sent as much as they may.
        """
        access, phone = self._access, self._access.phone
        with access.writing() as connection:
            access.require_room(connection, uploads=1, stored_bytes=num_bytes)
            if phone is not None:
                _require_room_of_phones(connection, phone, num_bytes)
            connection.execute(
                insert(uploads).values(
                    id=upload_id,
                    tenant=access.owner,
                    name=name,
                    num_bytes=num_bytes,
                    metadata=metadata,
                    expires_at=now() + keep_s,
                    spool=spool,
                    recording_id=None if phone is None else phone.recording_id,
                    phone=None if phone is None else phone.number,
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
        chosen = delete(uploads).where(self._may_reach(), uploads.c.id.in_(upload_ids))
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

    def _may_reach(self) -> ColumnElement[bool]:
        """Condition that an upload is the tenant's, and the phone's if a phone asks."""
        mine, phone = self._access.may_reach(uploads), self._access.phone
        if phone is None:
            return mine
        return mine & (uploads.c.recording_id == phone.recording_id) & (uploads.c.phone == phone.number)

    def _read(self, connection: Connection, upload_id: str) -> Upload:
        query = select(uploads).where(uploads.c.id == upload_id, self._may_reach(), uploads.c.expires_at >= now())
        row = connection.execute(query).one_or_none()
        if row is None:
            raise NotFound("There is no such upload.")
        return read(Upload, row)


def _require_room_of_phones(connection: Connection, phone: UploadingPhone, num_bytes: int) -> None:
    lock(connection, f"uploads of {phone.recording_id}")  # two phones at once must not both take the last place
    of_phones = select(func.count(), func.coalesce(func.sum(uploads.c.num_bytes), 0))
    num_uploads, sent_bytes = connection.execute(of_phones.where(uploads.c.recording_id == phone.recording_id)).one()
    if num_uploads >= phone.max_uploads or sent_bytes + num_bytes > phone.max_bytes:
        limits = f"{phone.max_uploads} uploads with {phone.max_bytes:,} bytes"
        raise Conflict(f"The phones of a recording may have {limits} at most; make sessions of takes, or discard some.")
