"""Edits of the people of sessions, and the people that jobs found."""

from collections.abc import Sequence

from sqlalchemy import Connection, select

from pipeline.core.options.edits import PeopleEdit, PersonSpan, edit_document
from worker.store.database.access import Access, Repository, existing
from worker.store.database.connection import upsert
from worker.store.database.rows import read_edits
from worker.store.database.tables import edits, found_people, jobs, sessions
from worker.store.errors import EditedMeanwhile
from worker.store.model.session_records import SessionEdits
from worker.store.repositories.audit import AuditAction, record_event
from worker.store.repositories.sessions import lock_session


class Edits(Repository):
    """Edits of a tenant's sessions, or of all sessions."""

    def get(self, session_id: str) -> SessionEdits:
        """Edits of a session; ``NotFound`` if there is none."""
        with self._access.reading() as connection:
            return read_session_edits(connection, self._access, session_id)

    def replace(self, session_id: str, new: Sequence[PeopleEdit], revision: int | None = None) -> SessionEdits:
        """Replace the edits of a session; see ``replace_edits``. Its jobs stay as they are."""
        with self._access.writing() as connection:
            return replace_edits(connection, self._access, session_id, new, revision)

    def people(self, job_id: str) -> tuple[PersonSpan, ...]:
        """People that a job found, before any edit, in the order of their numbers."""
        query = select(found_people).join(jobs).where(jobs.c.id == job_id, self._access.may_reach(jobs))
        with self._access.reading() as connection:
            return tuple(
                PersonSpan(row.id, row.start_frame, row.num_frames, tuple(map(tuple, row.places)))
                for row in connection.execute(query.order_by(found_people.c.id))
            )


def read_session_edits(connection: Connection, access: Access, session_id: str) -> SessionEdits:
    """Edits of a session; ``NotFound`` if there is none."""
    query = select(edits.c.revision, edits.c.list).select_from(sessions.outerjoin(edits))
    row = existing(
        connection.execute(query.where(sessions.c.id == session_id, access.may_reach(sessions))).one_or_none(),
        "session",
    )
    return SessionEdits() if row.revision is None else SessionEdits(row.revision, read_edits(row.list))


def replace_edits(
    connection: Connection, access: Access, session_id: str, new: Sequence[PeopleEdit], revision: int | None
) -> SessionEdits:
    """Replace the edits of a session, and lock it until the transaction ends.

    ``revision`` is the one that the caller has read; ``None``: any. Raises ``NotFound``, or ``EditedMeanwhile`` if the
    edits have another one.
    """
    tenant = lock_session(connection, access, session_id)
    before = read_session_edits(connection, access, session_id)
    if revision is not None and revision != before.revision:
        raise EditedMeanwhile(before.revision, revision)
    documents = [edit_document(edit) for edit in new]
    upsert(connection, edits, {"session_id": session_id, "revision": before.revision + 1, "list": documents})
    record_event(connection, access.actor, tenant, AuditAction.SESSION_EDITED, session_id)
    return SessionEdits(before.revision + 1, tuple(new))
