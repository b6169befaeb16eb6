"""Who did what: noted in the transaction that does it, kept when what it was done to is gone."""

from enum import StrEnum

from sqlalchemy import Connection, insert, select

from worker.jobs.database.connection import Database, now
from worker.jobs.database.tables import audit
from worker.jobs.model import Actor, Deed


class Act(StrEnum):
    """What can be done."""

    SESSION_CREATED = "session-created"
    SESSION_DELETED = "session-deleted"
    JOB_CREATED = "job-created"
    JOB_CANCELED = "job-canceled"
    JOB_RETRIED = "job-retried"
    JOB_DELETED = "job-deleted"
    UPLOAD_CREATED = "upload-created"
    UPLOAD_DELETED = "upload-deleted"
    KEY_CREATED = "key-created"
    KEY_REVOKED = "key-revoked"
    WEBHOOK_SECRET_MADE = "webhook-secret-made"  # noqa: S105 - an act
    BROWSER_LET_IN = "browser-let-in"


def note_deed(connection: Connection, actor: Actor, tenant: str, act: Act, subject: str) -> None:
    """Note what is done to a session, a job, an upload or a key."""
    connection.execute(
        insert(audit).values(
            done_at=now(), tenant=tenant, key_id=actor.key_id, request_id=actor.request_id, act=act, subject=subject
        )
    )


class Audit:
    """The store's list of what was done."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def deeds(self, tenant: str | None = None, limit: int = 100) -> list[Deed]:
        """What was done last, of one tenant or of all, the last one first."""
        query = select(audit).order_by(audit.c.id.desc()).limit(limit)
        if tenant is not None:
            query = query.where(audit.c.tenant == tenant)
        with self._database.reading() as connection:
            return [
                Deed(row.done_at, row.tenant, Actor(row.key_id, row.request_id), row.act, row.subject)
                for row in connection.execute(query)
            ]
