"""Links that open something without a key: of a job, such as one result file, or a recording, which phones join.

A link ends by itself, with its job or recording, and with the key that made it. The link of a recording also ends when
another one is made. Secrets are not stored, only their SHA-256: a search for the digest tells nothing about how much of
a guessed secret was right.
"""

import secrets
from collections.abc import Collection
from typing import Any

from sqlalchemy import ColumnElement, Connection, Select, delete, func, insert, or_, select
from uuid_utils import uuid7

from worker.store.database.access import Repository, ServiceRepository, existing
from worker.store.database.connection import now
from worker.store.database.rows import read
from worker.store.database.tables import jobs, keys, links, recordings
from worker.store.errors import Conflict
from worker.store.model.phone_records import JoinLink
from worker.store.model.rights import Link, LinkScope
from worker.store.repositories.audit import AuditAction, record_event
from worker.store.repositories.jobs import job_row
from worker.store.repositories.keys import digest, is_valid

MAX_LINKS = 1000
"""Largest number of valid links of a job."""

LINK_PREFIX = "mcl_"
"""Start of the secrets of all links."""
LINK_SECRET_BYTES = 32


class Links(Repository):
    """Links to the jobs of a tenant, or of all tenants."""

    def add(self, job_id: str, scope: LinkScope, name: str | None, lifetime_s: float) -> tuple[Link, str]:
        """Make a link; returns it with its secret, which can't be read again.

        Raises ``NotFound`` if there is no such job, ``Conflict`` if it has ``MAX_LINKS`` already.
        """
        link_id, secret = str(uuid7()), LINK_PREFIX + secrets.token_urlsafe(LINK_SECRET_BYTES)
        with self._access.writing() as connection:
            job = job_row(connection, self._access, job_id, lock=True)
            connection.execute(delete(links).where(links.c.expires_at < now()))
            num_links = connection.scalar(select(func.count()).select_from(links).where(links.c.job_id == job_id)) or 0
            if num_links >= MAX_LINKS:
                raise Conflict(f"The job has {MAX_LINKS} links already; revoke some, or wait until they end.")
            connection.execute(
                insert(links).values(
                    id=link_id,
                    sha256=digest(secret),
                    tenant=job.tenant,
                    job_id=job_id,
                    key_id=self._access.actor.key_id,
                    scope=scope,
                    name=name,
                    created_at=now(),
                    expires_at=now() + lifetime_s,
                )
            )
            record_event(connection, self._access.actor, job.tenant, AuditAction.LINK_CREATED, link_id)
            return read(Link, connection.execute(_select_links().where(links.c.id == link_id)).one()), secret

    def list_valid(self, job_id: str) -> list[Link]:
        """Valid links of a job, the newest first; ``NotFound`` without a job."""
        query = _select_links().where(links.c.job_id == job_id, *_are_valid()).order_by(links.c.id.desc())
        with self._access.reading() as connection:
            job_row(connection, self._access, job_id)
            return [read(Link, row) for row in connection.execute(query)]

    def revoke(self, link_id: str) -> None:
        """Revoke a link for good; ``NotFound`` if there is none."""
        with self._access.writing() as connection:
            tenant = self._require_tenant(connection, link_id)
            connection.execute(delete(links).where(links.c.id == link_id))
            record_event(connection, self._access.actor, tenant, AuditAction.LINK_REVOKED, link_id)

    def _require_tenant(self, connection: Connection, link_id: str) -> str:
        query = select(links.c.tenant).where(links.c.id == link_id, self._access.may_reach(links), *_are_valid())
        return existing(connection.scalar(query.select_from(links.outerjoin(keys))), "link")


class LinkSecrets(ServiceRepository):
    """Secrets of the links of all tenants, for requests that bring one."""

    def find(self, secret: str) -> Link | None:
        """Link with a secret; ``None`` if it is unknown, has ended, or its key is no longer valid."""
        if not secret.startswith(LINK_PREFIX):
            return None
        query = _select_links().where(links.c.sha256 == digest(secret), *_are_valid())
        with self._transactions.reading() as connection:
            row = connection.execute(query).one_or_none()
        return None if row is None else read(Link, row)

    def valid(self, link_ids: Collection[str]) -> set[str]:
        """Ids among some whose links are valid now."""
        query = select(links.c.id).select_from(links.outerjoin(keys)).where(links.c.id.in_(link_ids), *_are_valid())
        with self._transactions.reading() as connection:
            return set(connection.scalars(query))


def _select_links() -> Select[Any]:
    return select(links, jobs.c.session_id).select_from(links.join(jobs).outerjoin(keys))


def _are_valid() -> tuple[ColumnElement[bool], ...]:
    """Conditions that a link has not ended, and that its key is valid; one without a key ends with the first key."""
    has_no_keys = ~select(keys.c.id).correlate(None).exists()
    by_key = or_(links.c.key_id.is_not(None) & is_valid(), links.c.key_id.is_(None) & has_no_keys)
    return links.c.expires_at > now(), by_key


class JoinSecrets(ServiceRepository):
    """Secrets of the links of all recordings, for requests and WebSockets that bring one."""

    def find(self, secret: str) -> JoinLink | None:
        """Link with a secret; ``None`` if it is unknown or has ended."""
        if not secret.startswith(LINK_PREFIX):
            return None
        query = _select_valid(recordings.c.join_id, recordings.c.id, recordings.c.tenant)
        with self._transactions.reading() as connection:
            row = connection.execute(query.where(recordings.c.join_sha256 == digest(secret))).one_or_none()
        return None if row is None else JoinLink(row.join_id, row.id, row.tenant)

    def valid(self, link_ids: Collection[str]) -> set[str]:
        """Ids among some whose links are valid now."""
        query = _select_valid(recordings.c.join_id).where(recordings.c.join_id.in_(link_ids))
        with self._transactions.reading() as connection:
            return set(connection.scalars(query))


def _select_valid(*columns: ColumnElement[Any]) -> Select[Any]:
    """Columns of recordings whose links are valid; a link that no key made ends with the first key."""
    has_no_keys = ~select(keys.c.id).correlate(None).exists()
    by_key = or_(keys.c.id.is_not(None) & is_valid(), recordings.c.join_key_id.is_(None) & has_no_keys)
    joined = recordings.outerjoin(keys, keys.c.id == recordings.c.join_key_id)
    return select(*columns).select_from(joined).where(recordings.c.expires_at > now(), by_key)
