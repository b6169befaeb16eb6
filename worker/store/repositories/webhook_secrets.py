"""Webhook secrets: they sign the messages to a tenant."""

import base64
import secrets

from sqlalchemy import Connection, delete, insert, or_, select, update

from worker.store.database.connection import now
from worker.store.database.tables import webhook_secrets
from worker.store.database.transactions import Transactions
from worker.store.model.rights import Actor
from worker.store.model.webhooks import WebhookSecret
from worker.store.repositories.audit import AuditAction, record_event

_SECRET_BYTES = 32


class WebhookSecrets:
    """Webhook secrets of all tenants."""

    def __init__(self, transactions: Transactions) -> None:
        self._transactions = transactions

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
    return [WebhookSecret(row.secret, row.created_at, row.expires_at) for row in rows]
