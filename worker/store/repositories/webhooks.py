"""Webhooks: messages of jobs' ends that are to be delivered, and the secrets that sign them.

A message is queued in the transaction that ends its job, and stays until it is delivered or a day has passed. It may
arrive twice, under one id: the sender may be killed before it has recorded the delivery.
"""

import base64
import json
import secrets
from collections.abc import Mapping

from sqlalchemy import Connection, case, delete, func, insert, literal, or_, select, type_coerce, update
from uuid_utils import uuid7

from worker.store.database.access import ServiceRepository
from worker.store.database.connection import now
from worker.store.database.rows import read, read_jobs, select_jobs
from worker.store.database.tables import UtcTimestamp, deliveries, jobs, webhook_secrets
from worker.store.model.job_records import Delivery, WebhookSecret
from worker.store.model.rights import Actor
from worker.store.repositories.audit import AuditAction, record_event

# Time from each failed try to the next one: about a day in all.
_WAITS_S = (5.0, 30.0, 120.0, 600.0, 1800.0, 3600.0, 2 * 3600.0, 4 * 3600.0, 6 * 3600.0, 8 * 3600.0)
MAX_TRIES = len(_WAITS_S) + 1
_SECRET_BYTES = 32

_NONE_BUSY: Mapping[str, int] = {}


def queue_delivery(connection: Connection, job_id: str, *, of_files: bool) -> None:
    """Queue the message of a locked job's end, or of its files after an edit, if its spec names an address."""
    ended_at = type_coerce(now(), UtcTimestamp).label("ended_at")
    row = connection.execute(select(jobs.c.spec, jobs.c.tenant, ended_at).where(jobs.c.id == job_id)).one()
    url = row.spec.get("callback_url")
    if url is None:
        return
    (job,) = read_jobs(connection, connection.execute(select_jobs().where(jobs.c.id == job_id)).all())
    message = {
        "type": f"job.files_{job.files_state}" if of_files else f"job.{job.state}",
        "timestamp": row.ended_at.isoformat().replace("+00:00", "Z"),
        "data": {
            "id": job_id,
            "session_id": job.session_id,
            "state": job.state,
            "files_state": job.files_state,
            "attempt": job.attempt,
            "warnings": [warning.to_json() for warning in job.warnings],
        },
    }
    connection.execute(
        insert(deliveries).values(
            message_id=f"msg_{uuid7().hex}",
            job_id=job_id,
            tenant=row.tenant,
            url=url,
            body=json.dumps(message, separators=(",", ":")),
            created_at=now(),
            due_at=now(),
            tries=0,
        )
    )


class Webhooks(ServiceRepository):
    """Messages to be delivered, of all tenants."""

    def claim(
        self, limit: int, lease_s: float, limit_a_tenant: int | None = None, busy: Mapping[str, int] = _NONE_BUSY
    ) -> list[Delivery]:
        """Take messages that are due; they are due again after ``lease_s`` unless their outcome is recorded.

        ``limit_a_tenant`` messages of a tenant may be on their way at once; ``None``: no limit. Tenants with few
        ``busy`` ones, those on their way already, come first.
        """
        under_way = case(busy, value=deliveries.c.tenant, else_=0) if busy else literal(0)
        order = (deliveries.c.due_at, deliveries.c.id)
        turn = under_way + func.row_number().over(partition_by=deliveries.c.tenant, order_by=order)
        is_due = deliveries.c.due_at <= now()
        turns = select(deliveries.c.id, deliveries.c.due_at, turn.label("turn")).where(is_due).subquery()
        chosen = select(turns.c.id).order_by(turns.c.turn, turns.c.due_at).limit(limit)
        if limit_a_tenant is not None:
            chosen = chosen.where(turns.c.turn <= limit_a_tenant)
        # Checked once more: another sender may have taken them in between.
        due = select(deliveries).where(deliveries.c.id.in_(chosen), is_due).order_by(*order)
        with self._transactions.writing() as connection:
            rows = connection.execute(due.with_for_update(skip_locked=True)).all()
            connection.execute(
                update(deliveries)
                .where(deliveries.c.id.in_([row.id for row in rows]))
                .values(due_at=now() + lease_s, tries=deliveries.c.tries + 1)
            )
            return [read(Delivery, row, tries=row.tries + 1) for row in rows]

    def pending(self) -> list[Delivery]:
        """Messages that were not delivered, the oldest first."""
        with self._transactions.reading() as connection:
            rows = connection.execute(select(deliveries).order_by(deliveries.c.id))
            return [read(Delivery, row) for row in rows]

    def delivered(self, delivery: Delivery) -> None:
        """Delete a message that arrived, or that its receiver refuses for good."""
        with self._transactions.writing() as connection:
            connection.execute(delete(deliveries).where(deliveries.c.id == delivery.id))

    def failed(self, delivery: Delivery, problem: str) -> bool:
        """Record a failed try; return whether there will be another one."""
        if delivery.tries >= MAX_TRIES:
            self.delivered(delivery)
            return False
        # Messages that failed at one time should not all be sent again at one time.
        wait_s = _WAITS_S[delivery.tries - 1] * (0.9 + 0.2 * secrets.randbelow(1000) / 1000)
        with self._transactions.writing() as connection:
            connection.execute(
                update(deliveries).where(deliveries.c.id == delivery.id).values(due_at=now() + wait_s, problem=problem)
            )
        return True


class WebhookSecrets(ServiceRepository):
    """Webhook secrets of all tenants."""

    def rotate(self, tenant: str, keep_old_s: float) -> str:
        """Make the secret that signs a tenant's messages; an earlier one signs too, for ``keep_old_s``."""
        secret = "whsec_" + base64.b64encode(secrets.token_bytes(_SECRET_BYTES)).decode()
        newest = (webhook_secrets.c.tenant == tenant) & webhook_secrets.c.expires_at.is_(None)
        with self._transactions.writing() as connection:
            connection.execute(update(webhook_secrets).where(newest).values(expires_at=now() + keep_old_s))
            connection.execute(delete(webhook_secrets).where(webhook_secrets.c.expires_at <= now()))
            made = connection.execute(
                insert(webhook_secrets)
                .values(tenant=tenant, secret=secret, created_at=now())
                .returning(webhook_secrets.c.id)
            )
            subject = str(made.scalar_one())
            record_event(connection, Actor(), tenant, AuditAction.WEBHOOK_SECRET_MADE, subject)
        return secret

    def valid(self, tenant: str) -> list[WebhookSecret]:
        """Secrets that sign a tenant's messages now, the newest first."""
        with self._transactions.reading() as connection:
            return read_secrets(connection, tenant)


def read_secrets(connection: Connection, tenant: str) -> list[WebhookSecret]:
    """Secrets that sign a tenant's messages now, the newest first."""
    is_valid = or_(webhook_secrets.c.expires_at.is_(None), webhook_secrets.c.expires_at > now())
    query = select(webhook_secrets).where(webhook_secrets.c.tenant == tenant, is_valid)
    rows = connection.execute(query.order_by(webhook_secrets.c.id.desc()))
    return [read(WebhookSecret, row) for row in rows]
