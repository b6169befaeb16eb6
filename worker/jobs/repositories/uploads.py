"""Uploads: files that clients send in pieces, until they are a session's or their time is over.

Here is what was said of them when they were begun. How much of one has come is known to nobody but its file, which is
on the spool of the API that receives it.
"""

from collections.abc import Collection
from typing import Any

from sqlalchemy import Connection, Row, delete, insert, select, update

from worker.jobs.database.connection import now
from worker.jobs.database.tables import uploads
from worker.jobs.errors import Conflict, NotFound
from worker.jobs.model import Upload
from worker.jobs.repositories.audit import Act, note_deed
from worker.jobs.repositories.idempotency_keys import Receipts


class Uploads(Receipts):
    """A tenant's uploads. One whose time is over is not there."""

    def create_upload(self, upload_id: str, name: str, num_bytes: int, metadata: str, keep_s: float) -> Upload:
        """Record an upload; its bytes count for the tenant's quota from now on.

        Parameters
        ----------
        upload_id
            As its file is called.
        name
            Of the file.
        num_bytes
            Of the whole file.
        metadata
            As the client sent it; it gets it back.
        keep_s
            How long it is kept, from now on and again from each ``renew_upload``.

        Raises
        ------
        QuotaExceeded
        """
        with self._database.writing() as connection:
            self._require_room(connection, uploads=1, stored_bytes=num_bytes)
            connection.execute(
                insert(uploads).values(
                    id=upload_id,
                    tenant=self._owner,
                    name=name,
                    num_bytes=num_bytes,
                    metadata=metadata,
                    expires_at=now() + keep_s,
                )
            )
            note_deed(connection, self._actor, self._owner, Act.UPLOAD_CREATED, upload_id)
            upload = self._upload(connection, upload_id)
            self._leave_receipt(connection, upload)
            return upload

    def upload(self, upload_id: str) -> Upload:
        """An upload; ``NotFound`` if there is none."""
        with self._database.reading() as connection:
            return self._upload(connection, upload_id)

    def renew_upload(self, upload_id: str, keep_s: float) -> Upload:
        """Keep an upload for longer; ``NotFound`` if there is none."""
        with self._database.writing() as connection:
            self._upload(connection, upload_id)
            connection.execute(update(uploads).where(uploads.c.id == upload_id).values(expires_at=now() + keep_s))
            return self._upload(connection, upload_id)

    def delete_upload(self, upload_id: str) -> None:
        """Forget an upload; ``NotFound`` if there is none."""
        with self._database.writing() as connection:
            self._upload(connection, upload_id)
            connection.execute(delete(uploads).where(uploads.c.id == upload_id))
            note_deed(connection, self._actor, self._owner, Act.UPLOAD_DELETED, upload_id)

    def expired_uploads(self) -> list[str]:
        """Ids of those whose time is over."""
        query = select(uploads.c.id).where(self._mine(uploads), uploads.c.expires_at < now())
        with self._database.reading() as connection:
            return list(connection.scalars(query))

    def forget_expired_upload(self, upload_id: str) -> None:
        """Forget an upload if its time is over still."""
        with self._database.writing() as connection:
            connection.execute(delete(uploads).where(uploads.c.id == upload_id, uploads.c.expires_at < now()))

    def known_uploads(self, upload_ids: Collection[str]) -> set[str]:
        """Those of some ids that are an upload's, expired or not."""
        query = select(uploads.c.id).where(self._mine(uploads), uploads.c.id.in_(upload_ids))
        with self._database.reading() as connection:
            return set(connection.scalars(query))

    def _use_up(self, connection: Connection, upload_ids: Collection[str]) -> None:
        """Forget uploads whose files become a session's; ``Conflict`` if one is not there any more."""
        if not upload_ids:
            return
        found = connection.execute(delete(uploads).where(self._mine(uploads), uploads.c.id.in_(upload_ids)))
        if found.rowcount != len(upload_ids):
            raise Conflict("An upload was deleted, or used for another session, in the meantime.")

    def _upload(self, connection: Connection, upload_id: str) -> Upload:
        query = select(uploads).where(uploads.c.id == upload_id, self._mine(uploads), uploads.c.expires_at >= now())
        row = connection.execute(query).one_or_none()
        if row is None:
            raise NotFound("There is no such upload.")
        return _upload_of(row)


def _upload_of(row: Row[Any]) -> Upload:
    return Upload(row.id, row.name, row.num_bytes, row.metadata, row.expires_at)
