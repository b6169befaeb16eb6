"""Webhooks: what has to be told to whom, and the secrets that sign it.

A message is queued in the transaction that ends its job, and stays until somebody took it or a day has passed. It may
arrive twice, under one id: whoever sends it may be killed before it has noted that it arrived.
"""

import base64
import json
import secrets
from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy import Connection, Row, case, delete, func, insert, literal, or_, select, type_coerce, update
from uuid_utils import uuid7

from worker.jobs.database.connection import Database, now
from worker.jobs.database.rows import jobs_of, select_jobs
from worker.jobs.database.tables import Moment, deliveries, jobs, webhook_secrets
from worker.jobs.model import Actor, Delivery, JobState, WebhookSecret
from worker.jobs.repositories.audit import Act, note_deed

# After each try that came to nothing, until the next one: about a day in all.
_WAITS_S = (5.0, 30.0, 120.0, 600.0, 1800.0, 3600.0, 2 * 3600.0, 4 * 3600.0, 6 * 3600.0, 8 * 3600.0)
MAX_TRIES = len(_WAITS_S) + 1

_NOBODY: Mapping[str, int] = {}
_SECRET_BYTES = 32


def queue_delivery(connection: Connection, job_id: str, state: JobState) -> None:
    """Note that a locked job's end has to be told, if somebody asked for that."""
    row = connection.execute(
        select(jobs.c.spec, jobs.c.tenant, type_coerce(now(), Moment).label("ended_at")).where(jobs.c.id == job_id)
    ).one()
    url = row.spec.get("callback_url")
    if url is None:
        return
    (job,) = jobs_of(connection, connection.execute(select_jobs().where(jobs.c.id == job_id)).all())
    said = {
        "type": f"job.{state}",
        "timestamp": row.ended_at.isoformat().replace("+00:00", "Z"),
        "data": {
            "id": job_id,
            "session_id": job.session_id,
            "state": state,
            "attempt": job.attempt,
            "warnings": list(job.warnings),
        },
    }
    connection.execute(
        insert(deliveries).values(
            message_id=f"msg_{uuid7().hex}",
            job_id=job_id,
            tenant=row.tenant,
            url=url,
            body=json.dumps(said, separators=(",", ":")),
            created_at=now(),
            due_at=now(),
            tries=0,
        )
    )


class Deliveries:
    """The store's webhooks."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def claim_deliveries(
        self, limit: int, lease_s: float, limit_a_tenant: int | None = None, busy: Mapping[str, int] = _NOBODY
    ) -> list[Delivery]:
        """Take messages that are due; they are due again after ``lease_s`` unless it is said what became of them.

        Parameters
        ----------
        limit_a_tenant
            How many messages of one tenant may be on their way at once; ``None``: as many as there are.
        busy
            How many are on their way already, by tenant. Tenants with few of them come first.
        """
        under_way = case(busy, value=deliveries.c.tenant, else_=0) if busy else literal(0)
        order = (deliveries.c.due_at, deliveries.c.id)
        turn = under_way + func.row_number().over(partition_by=deliveries.c.tenant, order_by=order)
        is_due = deliveries.c.due_at <= now()
        turns = select(deliveries.c.id, deliveries.c.due_at, turn.label("turn")).where(is_due).subquery()
        chosen = select(turns.c.id).order_by(turns.c.turn, turns.c.due_at).limit(limit)
        if limit_a_tenant is not None:
            chosen = chosen.where(turns.c.turn <= limit_a_tenant)
        # Once more: another sender may have taken them in between.
        due = select(deliveries).where(deliveries.c.id.in_(chosen), is_due).order_by(*order)
        with self._database.writing() as connection:
            rows = connection.execute(due.with_for_update(skip_locked=True)).all()
            connection.execute(
                update(deliveries)
                .where(deliveries.c.id.in_([row.id for row in rows]))
                .values(due_at=now() + lease_s, tries=deliveries.c.tries + 1)
            )
            return [_delivery_of(row, row.tries + 1) for row in rows]

    def deliveries(self) -> list[Delivery]:
        """What has not arrived, the oldest first."""
        with self._database.reading() as connection:
            rows = connection.execute(select(deliveries).order_by(deliveries.c.id))
            return [_delivery_of(row, row.tries) for row in rows]

    def delivered(self, delivery: Delivery) -> None:
        """Say that a message arrived, or that nobody wants it."""
        with self._database.writing() as connection:
            connection.execute(delete(deliveries).where(deliveries.c.id == delivery.id))

    def not_delivered(self, delivery: Delivery, problem: str) -> bool:
        """Say that a try came to nothing; whether there will be another one."""
        if delivery.tries >= MAX_TRIES:
            self.delivered(delivery)
            return False
        # Those that failed at one time need not all come again at one time.
        wait_s = _WAITS_S[delivery.tries - 1] * (0.9 + 0.2 * secrets.randbelow(1000) / 1000)
        with self._database.writing() as connection:
            connection.execute(
                update(deliveries).where(deliveries.c.id == delivery.id).values(due_at=now() + wait_s, problem=problem)
            )
        return True

    def rotate_webhook_secret(self, tenant: str, keep_old_s: float) -> str:
        """Make the secret that signs a tenant's messages; an earlier one signs, too, for a while."""
        secret = "whsec_" + base64.b64encode(secrets.token_bytes(_SECRET_BYTES)).decode()
        mine = webhook_secrets.c.tenant == tenant
        with self._database.writing() as connection:
            connection.execute(
                update(webhook_secrets)
                .where(mine, webhook_secrets.c.expires_at.is_(None))
                .values(expires_at=now() + keep_old_s)
            )
            connection.execute(delete(webhook_secrets).where(webhook_secrets.c.expires_at <= now()))
            made = connection.execute(
                insert(webhook_secrets)
                .values(tenant=tenant, secret=secret, created_at=now())
                .returning(webhook_secrets.c.id)
            )
            note_deed(connection, Actor(), tenant, Act.WEBHOOK_SECRET_MADE, str(made.scalar_one()))
        return secret

    def webhook_secrets(self, tenant: str) -> Sequence[WebhookSecret]:
        """What signs a tenant's messages now, the newest first."""
        with self._database.reading() as connection:
            return read_secrets(connection, tenant)


def read_secrets(connection: Connection, tenant: str) -> list[WebhookSecret]:
    """What signs a tenant's messages now, the newest first."""
    valid = or_(webhook_secrets.c.expires_at.is_(None), webhook_secrets.c.expires_at > now())
    query = select(webhook_secrets).where(webhook_secrets.c.tenant == tenant, valid)
    rows = connection.execute(query.order_by(webhook_secrets.c.id.desc()))
    return [WebhookSecret(row.secret, row.created_at, row.expires_at) for row in rows]


def _delivery_of(row: Row[Any], tries: int) -> Delivery:
    return Delivery(
        id=row.id,
        message_id=row.message_id,
        job_id=row.job_id,
        tenant=row.tenant,
        url=row.url,
        body=row.body,
        due_at=row.due_at,
        tries=tries,
        problem=row.problem,
    )
