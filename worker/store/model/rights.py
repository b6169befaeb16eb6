"""Rights: keys and links, who did what, and how much a tenant has of what quotas limit."""

from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum

DEFAULT_TENANT = "default"
"""Tenant of everything as long as there are no keys."""


class Scope(StrEnum):
    """Permission of a key; no scope includes another one."""

    READ = "read"  # read the tenant's sessions, jobs and results
    WRITE = "write"  # add, change and delete them
    ADMIN = "admin"  # read figures of the whole service


@dataclass(frozen=True, slots=True)
class Key:
    """Key of the service. Requests with the key reach the records of ``tenant``."""

    id: str
    tenant: str
    name: str
    scopes: frozenset[Scope]
    created_at: datetime
    expires_at: datetime | None
    revoked_at: datetime | None


@dataclass(frozen=True, slots=True)
class Actor:
    """Key and request of an action; both ``None`` at the command line, and the key if the service has no keys."""

    key_id: str | None = None
    request_id: str | None = None


@dataclass(frozen=True, slots=True)
class AuditEvent:
    """Action on a session, a job, an upload or a key, whose id is ``subject``.

    Values of ``act``: ``worker.store.repositories.audit.AuditAction``.
    """

    done_at: datetime
    tenant: str
    key_id: str | None  # This and the request are as in ``Actor``
    request_id: str | None
    act: str
    subject: str


class LinkScope(StrEnum):
    """Target of a link."""

    FILE = "file"  # one result file, or all as a zip
    VIDEO = "video"  # the video of one camera
    EVENTS = "events"  # the event stream
    JOB = "job"  # the job to look at: all of these, and what viewers read


@dataclass(frozen=True, slots=True)
class Link:
    """Link that opens something of a job without a key, until ``expires_at``."""

    id: str
    tenant: str
    job_id: str
    session_id: str  # Session of the job
    scope: LinkScope
    name: str | None  # Name of the result file or of the camera; ``None`` for scopes without one
    created_at: datetime
    expires_at: datetime


@dataclass(frozen=True, slots=True)
class Usage:
    """Amounts that a tenant has of what quotas limit."""

    sessions: int
    unfinished_jobs: int
    stored_bytes: int
    uploads: int
