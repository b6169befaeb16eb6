"""Capture sessions."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from types import MappingProxyType
from typing import Any

from sqlalchemy import Connection, delete, insert, select
from uuid_utils import uuid7

from pipeline.capture.preflight_record import Preflight
from worker.jobs.database.access import Access
from worker.jobs.database.connection import now
from worker.jobs.database.removal_notes import keep, remove_later, remove_unless_kept
from worker.jobs.database.rows import session_of
from worker.jobs.database.tables import jobs, sessions
from worker.jobs.errors import Conflict, NotFound
from worker.jobs.files.artifacts import job_prefix, session_prefix
from worker.jobs.model import FINISHED, InputFile, Purpose, Session
from worker.jobs.repositories.audit import AuditAction, record_event
from worker.jobs.repositories.calibrations import forget_unmade

_NO_METADATA: Mapping[str, Any] = MappingProxyType({})


class Sessions:
    """Sessions of a tenant, or of all tenants."""

    def __init__(self, access: Access) -> None:
        self._access = access

    def reserve_id(self) -> str:
        """Make the id of a session whose files are about to be stored.

        The files are removed after a day unless ``add`` is called with the id.
        """
        session_id = str(uuid7())
        with self._access.writing() as connection:
            remove_unless_kept(connection, session_prefix(session_id))
        return session_id

    def add(
        self,
        name: str,
        files: Sequence[InputFile],
        preflight: Preflight,
        session_id: str,
        metadata: Mapping[str, Any] = _NO_METADATA,
        record_sha256: str | None = None,
        purpose: Purpose = "capture",
    ) -> Session:
        """Add a session whose files are in the artifact store.

        Parameters
        ----------
        session_id
            Made by ``reserve_id``.
        metadata
            JSON object of the client, stored as it is.
        record_sha256
            Digest of the preflight record in the artifact store; ``None``: the record is read without a comparison.
        purpose
            See ``worker.jobs.model.Session``.

        Raises
        ------
        Conflict
            The files took more than a day to arrive, and were removed.
        QuotaExceeded
        """
        access, num_bytes = self._access, sum(file.num_bytes for file in files)
        with access.writing() as connection:
            access.require_room(connection, sessions=1, stored_bytes=num_bytes)
            if not keep(connection, session_prefix(session_id)):
                raise Conflict("The session's files took too long to arrive; send them again.")
            connection.execute(
                insert(sessions).values(
                    id=session_id,
                    name=name,
                    created_at=now(),
                    files=[asdict(file) for file in files],
                    preflight=preflight.to_json(),
                    client_metadata=dict(metadata),
                    num_bytes=num_bytes,
                    tenant=access.owner,
                    record_sha256=record_sha256,
                    purpose=purpose,
                )
            )
            record_event(connection, access.actor, access.owner, AuditAction.SESSION_CREATED, session_id)
            return self._read(connection, session_id)

    def get(self, session_id: str) -> Session:
        """Session with an id; ``NotFound`` if there is none."""
        with self._access.reading() as connection:
            return self._read(connection, session_id)

    def page(self, limit: int = 50, after: str | None = None) -> list[Session]:
        """Sessions that are captures, the newest first; ``after`` is the last id of the page before."""
        is_listed = (self._access.may_reach(sessions), sessions.c.purpose == "capture")
        query = select(sessions).where(*is_listed).order_by(sessions.c.id.desc()).limit(limit)
        if after is not None:
            query = query.where(sessions.c.id < after)
        with self._access.reading() as connection:
            return [session_of(row) for row in connection.execute(query)]

    def delete(self, session_id: str) -> None:
        """Delete a session and its jobs, and note their files for removal.

        Raises
        ------
        NotFound
        Conflict
            A job of the session is unfinished.
        """
        with self._access.writing() as connection:
            tenant = lock_session(connection, self._access, session_id)
            of_session = connection.execute(select(jobs.c.id, jobs.c.state).where(jobs.c.session_id == session_id))
            for job in of_session.all():
                if job.state not in FINISHED:
                    raise Conflict("A job of this session is unfinished.")
                remove_later(connection, job_prefix(job.id))
                forget_unmade(connection, job.id)
            remove_later(connection, session_prefix(session_id))
            record_event(connection, self._access.actor, tenant, AuditAction.SESSION_DELETED, session_id)
            connection.execute(delete(sessions).where(sessions.c.id == session_id))

    def _read(self, connection: Connection, session_id: str) -> Session:
        query = select(sessions).where(sessions.c.id == session_id, self._access.may_reach(sessions))
        row = connection.execute(query).one_or_none()
        if row is None:
            raise NotFound("There is no such session.")
        return session_of(row)


def lock_session(connection: Connection, access: Access, session_id: str) -> str:
    """Lock a session until the transaction ends, and return its tenant; ``NotFound`` if there is none.

    A locked session is not deleted, and gets no jobs.
    """
    query = select(sessions.c.tenant).where(sessions.c.id == session_id, access.may_reach(sessions)).with_for_update()
    tenant: str | None = connection.scalar(query)
    if tenant is None:
        raise NotFound("There is no such session.")
    return tenant
