"""Uploads: files that clients send, or the service fetches, in pieces, until a session takes them or they expire.

A row holds the announcement. The number of bytes that have arrived is the size of the file on the spool of the API
that receives it. One API process fetches an upload at a time: it renews the time at which the fetch is due again.
"""

from collections import defaultdict
from collections.abc import Collection, Mapping
from dataclasses import asdict
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, delete, func, insert, select, update

from worker.store.database.access import Repository, existing
from worker.store.database.connection import lock, now
from worker.store.database.rows import read
from worker.store.database.tables import uploads
from worker.store.errors import Conflict
from worker.store.model.job_records import JobProblem
from worker.store.model.phone_records import UploadingPhone
from worker.store.model.session_records import Fetch, Upload
from worker.store.repositories.audit import AuditAction, record_event

_IS_DUE = uploads.c.fetch_due_at <= now()


class Uploads(Repository):
    """Uploads of a tenant, or of all tenants. An expired upload is treated as unknown."""

    def add(
        self,
        upload_id: str,
        name: str,
        num_bytes: int,
        metadata: str,
        keep_s: float,
        spool: str,
        source_url: str | None = None,
    ) -> Upload:
        """Add an upload; its bytes count for the tenant's quota from now on.

        - ``upload_id``: name of its file on the spool.
        - ``name``: name that the client gave the file.
        - ``num_bytes``: size of the complete file.
        - ``metadata``: text of the client, stored as it is.
        - ``keep_s``: time until it expires; begins again with each ``renew``.
        - ``spool``: host and folder that hold its bytes.
        - ``source_url``: URL that the service fetches the file from, which is due at once; ``None``: the client sends
          the file.

        Raises ``QuotaExceeded``. Raises ``Conflict``: the phones of a recording have sent as much as they may.
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
                    source_url=source_url,
                    fetch_due_at=None if source_url is None else now(),
                )
            )
            record_event(connection, access.actor, access.owner, AuditAction.UPLOAD_CREATED, upload_id)
            return self._read(connection, upload_id)

    def get(self, upload_id: str) -> Upload:
        """Upload with an id; ``NotFound`` if there is none."""
        with self._access.reading() as connection:
            return self._read(connection, upload_id)

    def due_fetches(self) -> list[Fetch]:
        """Fetches that no process is at work on, the oldest first."""
        query = select(uploads).where(self._access.may_reach(uploads), _IS_DUE, uploads.c.expires_at >= now())
        with self._access.reading() as connection:
            rows = connection.execute(query.order_by(uploads.c.id)).all()
        return [Fetch(_upload(row), row.tenant, row.source_url, row.source_validator) for row in rows]

    def claim_fetch(self, upload_id: str, lease_s: float) -> bool:
        """Take a fetch, which is due again after ``lease_s``; return whether no other process was faster."""
        claimed = update(uploads).where(uploads.c.id == upload_id, _IS_DUE).values(fetch_due_at=now() + lease_s)
        with self._access.writing() as connection:
            return connection.execute(claimed).rowcount == 1

    def renew_fetches(self, fetched_bytes: Mapping[str, int], lease_s: float, keep_s: float) -> set[str]:
        """Keep fetches, and all uploads that their sessions wait for, for longer; return the ids that still exist.

        ``fetched_bytes`` are the bytes that have come, by the ids of the uploads.
        """
        renewed = set()
        with self._access.writing() as connection:
            for upload_id, num_bytes in fetched_bytes.items():
                chosen = uploads.c.id == upload_id, uploads.c.fetch_due_at.is_not(None)
                values = {"fetch_due_at": now() + lease_s, "fetched_bytes": num_bytes}
                if connection.execute(update(uploads).where(*chosen).values(**values)).rowcount:
                    renewed.add(upload_id)
            waiting = select(uploads.c.session_id).where(uploads.c.id.in_(renewed)).scalar_subquery()
            kept = uploads.c.id.in_(renewed) | uploads.c.session_id.in_(waiting)
            connection.execute(update(uploads).where(kept).values(expires_at=now() + keep_s))
        return renewed

    def announce(self, upload_id: str, num_bytes: int, validator: str | None) -> Upload:
        """Record the size of a file that is fetched, which counts for the tenant's quota from now on.

        Raises ``NotFound``, or ``QuotaExceeded``.
        """
        values = {"num_bytes": num_bytes, "source_validator": validator}
        with self._access.writing() as connection:
            self._access.require_room(connection, stored_bytes=num_bytes - self._read(connection, upload_id).num_bytes)
            connection.execute(update(uploads).where(uploads.c.id == upload_id).values(**values))
            return self._read(connection, upload_id)

    def end_fetch(self, upload_id: str, problem: JobProblem | None = None) -> None:
        """Record that a file was fetched, or the problem, and forget its URL; a deleted upload stays deleted."""
        ended: dict[str, Any] = {"source_url": None, "source_validator": None, "fetch_due_at": None}
        if problem is None:
            ended["fetched_bytes"] = uploads.c.num_bytes
        document = None if problem is None else asdict(problem)
        with self._access.writing() as connection:
            connection.execute(update(uploads).where(uploads.c.id == upload_id).values(problem=document, **ended))

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
        the uploads is unknown, or another session waits for it.
        """
        if not upload_ids:
            return
        chosen = delete(uploads).where(self._may_reach(), uploads.c.id.in_(upload_ids), uploads.c.session_id.is_(None))
        with self._access.writing() as connection:
            if connection.execute(chosen).rowcount != len(upload_ids):
                raise Conflict("An upload was deleted, or used for another capture, in the meantime.")

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
        row = existing(connection.execute(query).one_or_none(), "upload")
        return _upload(row)


def awaited_uploads(connection: Connection, session_ids: Collection[str]) -> Mapping[str, list[Upload]]:
    """Uploads that sessions wait for, in the order in which they were begun."""
    found = defaultdict[str, list[Upload]](list)
    if session_ids:
        query = select(uploads).where(uploads.c.session_id.in_(session_ids)).order_by(uploads.c.id)
        for row in connection.execute(query):
            found[row.session_id].append(_upload(row))
    return found


def _upload(row: Row[Any]) -> Upload:
    return read(Upload, row, is_fetching=row.fetch_due_at is not None)


def _require_room_of_phones(connection: Connection, phone: UploadingPhone, num_bytes: int) -> None:
    lock(connection, f"uploads of {phone.recording_id}")  # two phones at once must not both take the last place
    of_phones = select(func.count(), func.coalesce(func.sum(uploads.c.num_bytes), 0))
    num_uploads, sent_bytes = connection.execute(of_phones.where(uploads.c.recording_id == phone.recording_id)).one()
    if num_uploads >= phone.max_uploads or sent_bytes + num_bytes > phone.max_bytes:
        limits = f"{phone.max_uploads} uploads with {phone.max_bytes:,} bytes"
        raise Conflict(f"The phones of a recording may have {limits} at most; make captures of takes, or discard some.")
