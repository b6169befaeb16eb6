"""Audit: actions on sessions, jobs, uploads, links and keys, with the key of each action.

An event is recorded in the transaction of the action, and outlives its subject.
"""

from enum import StrEnum

from sqlalchemy import Connection, insert, select

from worker.store.database.access import ServiceRepository, newest_first
from worker.store.database.connection import now
from worker.store.database.rows import read
from worker.store.database.tables import audit
from worker.store.model.rights import Actor, AuditEvent


class AuditAction(StrEnum):
    """Actions that are recorded."""

    SESSION_CREATED = "session-created"
    SESSION_RENAMED = "session-renamed"
    SESSION_EDITED = "session-edited"
    SESSION_DELETED = "session-deleted"
    VIDEOS_DELETED = "videos-deleted"
    JOB_CREATED = "job-created"
    JOB_CANCELED = "job-canceled"
    JOB_RETRIED = "job-retried"
    FILES_REMADE = "files-remade"
    JOB_DELETED = "job-deleted"
    UPLOAD_CREATED = "upload-created"
    UPLOAD_DELETED = "upload-deleted"
    CALIBRATION_CREATED = "calibration-created"
    CALIBRATION_RENAMED = "calibration-renamed"
    CALIBRATION_DELETED = "calibration-deleted"
    CHARACTER_CREATED = "character-created"
    CHARACTER_RENAMED = "character-renamed"
    CHARACTER_CORRECTED = "character-corrected"
    CHARACTER_DELETED = "character-deleted"
    RECORDING_CREATED = "recording-created"
    RECORDING_DELETED = "recording-deleted"
    LINK_CREATED = "link-created"
    LINK_REVOKED = "link-revoked"
    KEY_CREATED = "key-created"
    KEY_REVOKED = "key-revoked"
    WEBHOOK_SECRET_MADE = "webhook-secret-made"  # noqa: S105 - an action
    BROWSER_LET_IN = "browser-let-in"


def record_event(connection: Connection, actor: Actor, tenant: str, action: AuditAction, subject: str) -> None:
    """Record an action on a session, a calibration, a character, a job, an upload or a key; ``subject`` is its id."""
    connection.execute(
        insert(audit).values(
            done_at=now(), tenant=tenant, key_id=actor.key_id, request_id=actor.request_id, act=action, subject=subject
        )
    )


class Audit(ServiceRepository):
    """Audit events of all tenants."""

    def events(self, tenant: str | None = None, limit: int = 100) -> list[AuditEvent]:
        """Last events of a tenant or of all tenants, the newest first."""
        query = newest_first(select(audit), audit, limit)
        if tenant is not None:
            query = query.where(audit.c.tenant == tenant)
        with self._transactions.reading() as connection:
            return [read(AuditEvent, row) for row in connection.execute(query)]
