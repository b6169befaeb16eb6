"""Webhook messages and the secrets that sign them."""

from dataclasses import dataclass, field
from datetime import datetime


@dataclass(frozen=True, slots=True)
class Delivery:
    """Webhook message of a job's end. ``tries`` includes the present try; ``problem`` is that of the last one."""

    id: int
    message_id: str
    job_id: str
    tenant: str
    url: str
    body: str
    due_at: datetime
    tries: int
    problem: str | None


@dataclass(frozen=True, slots=True)
class WebhookSecret:
    """Secret that signs webhook messages, until ``expires_at`` if there is a newer one."""

    secret: str = field(repr=False)
    created_at: datetime
    expires_at: datetime | None
