"""Capture sessions, edits of their people, and the people that jobs found."""

import unicodedata
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from types import MappingProxyType
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, Select, and_, case, delete, false, func, insert, select, update

from pipeline.capture.preflight_record import Preflight
from pipeline.core.options.config import DEFAULT_CHUNK_FRAMES
from pipeline.core.options.edits import PeopleEdit, PersonSpan, edit_document
from pipeline.core.options.job_choices import BLURRED_KIND
from worker.store.database.access import Access, Repository, existing, newest_first
from worker.store.database.connection import now, upsert
from worker.store.database.rows import is_in_state, read_edits, read_session
from worker.store.database.stored_files import StoringRepository, forget_answers, keep, remove_later
from worker.store.database.tables import BLURS_FACES, edits, found_people, jobs, results, sessions
from worker.store.errors import Conflict, EditedMeanwhile, NotFound
from worker.store.files.file_keys import job_prefix, session_prefix, thumbnails_prefix
from worker.store.model.job_records import SIDE_KINDS, NewestJob
from worker.store.model.session_records import Capture, InputFile, Purpose, Session, SessionEdits
from worker.store.model.states import FINISHED, UNFINISHED, JobState, job_state
from worker.store.repositories.audit import AuditAction, record_event
from worker.store.repositories.calibrations import forget_unmade
from worker.store.repositories.uploads import awaited_uploads

_NO_METADATA: Mapping[str, Any] = MappingProxyType({})


class Sessions(StoringRepository):
    """Sessions of a tenant, or of all tenants."""

    _prefix = staticmethod(session_prefix)

    def add(
        self,
        name: str,
        files: Sequence[InputFile],
        preflight: Preflight,
        session_id: str,
        metadata: Mapping[str, Any] = _NO_METADATA,
        record_sha256: str | None = None,
        purpose: Purpose = "capture",
        chunk_frames: int = DEFAULT_CHUNK_FRAMES,
        arrival: Mapping[str, Any] | None = None,
    ) -> Session:
        """Add a session whose files are in the artifact store, or are fetched.

        - ``session_id``: made by ``reserve_id``.
        - ``metadata``: JSON object of the client, stored as it is.
        - ``record_sha256``: digest of the preflight record in the artifact store; ``None``: the record is read without
          a comparison.
        - ``purpose``, ``chunk_frames``, ``arrival``: see ``worker.store.model.session_records.Session``.

        Raises ``QuotaExceeded``. Raises ``Conflict``: the files took more than a day to arrive, and were removed.
        """
        access, num_bytes = self._access, sum(file.num_bytes for file in files)
        with access.writing() as connection:
            access.require_room(connection, sessions=1, stored_bytes=num_bytes)
            if not keep(connection, session_prefix(session_id)):
                raise Conflict("The capture's files took too long to arrive; send them again.")
            connection.execute(
                insert(sessions).values(
                    id=session_id,
                    name=name,
                    search_name=searchable(name),
                    created_at=now(),
                    files=[asdict(file) for file in files],
                    preflight=preflight.to_json(),
                    client_metadata=dict(metadata),
                    num_bytes=num_bytes,
                    tenant=access.owner,
                    record_sha256=record_sha256,
                    purpose=purpose,
                    chunk_frames=chunk_frames,
                    arrival=arrival,
                    arrival_due_at=None if arrival is None else now(),
                )
            )
            record_event(connection, access.actor, access.owner, AuditAction.SESSION_CREATED, session_id)
            return self._read(connection, session_id)

    def get(self, session_id: str, may_wait: bool = False) -> Session:
        """Session with an id; ``NotFound`` if there is none, ``Conflict`` if its files are not there.

        ``may_wait``: its videos may still be fetched.
        """
        with self._access.reading() as connection:
            session = self._read(connection, session_id)
        if session.state == "failed" or (session.state == "fetching" and not may_wait):
            raise Conflict("The videos of this capture are not there; reading the capture tells why.")
        return session

    def capture(self, session_id: str) -> Capture:
        """Session with an id, and its reconstructions; ``NotFound`` if there is none."""
        with self._access.reading() as connection:
            return self._read_capture(connection, session_id)

    def page(
        self, limit: int = 50, after: str | None = None, name: str | None = None, state: JobState | None = None
    ) -> list[Capture]:
        """Sessions that are captures, the newest first.

        ``after`` is the last id of the page before. Names contain ``name``; case and compatible forms of characters do
        not count. The newest job of each is in ``state``.
        """
        is_listed = (self._access.may_reach(sessions), sessions.c.purpose == "capture")
        query = newest_first(_select_captures().where(*is_listed), sessions, limit, after)
        if name is not None:
            query = query.where(sessions.c.search_name.contains(searchable(name), autoescape=True))
        if state is not None:
            query = query.where(is_in_state(state))
        with self._access.reading() as connection:
            return _read_captures(connection, connection.execute(query).all())

    def locked(self, session_id: str) -> Capture:
        """Session with an id, locked until the transaction ends; ``NotFound`` if there is none."""
        with self._access.writing() as connection:
            lock_session(connection, self._access, session_id)
            return self._read_capture(connection, session_id)

    def rename(self, session_id: str, name: str) -> Capture:
        """Give a session another name; ``NotFound`` if there is none."""
        with self._access.writing() as connection:
            tenant = lock_session(connection, self._access, session_id)
            changed = connection.execute(
                update(sessions)
                .where(sessions.c.id == session_id, sessions.c.name != name)
                .values(name=name, search_name=searchable(name))
            )
            if changed.rowcount == 1:
                record_event(connection, self._access.actor, tenant, AuditAction.SESSION_RENAMED, session_id)
            return self._read_capture(connection, session_id)

    def delete(self, session_id: str) -> None:
        """Delete a session and its jobs, and note their files for removal.

        Raises ``NotFound``, or ``Conflict`` if a job of the session is unfinished.
        """
        with self._access.writing() as connection:
            tenant = lock_session(connection, self._access, session_id)
            of_session = connection.execute(
                select(jobs.c.id, jobs.c.state, jobs.c.kind).where(jobs.c.session_id == session_id)
            )
            for job in of_session.all():
                # No client waits for such jobs: a worker stops when it finds its job gone.
                if job.state not in FINISHED and job.kind not in SIDE_KINDS:
                    raise Conflict(f"The job {job.id} of this capture is unfinished; cancel it first.")
                remove_later(connection, job_prefix(job.id))
                forget_unmade(connection, job.id)
            remove_later(connection, session_prefix(session_id))
            forget_answers(connection, tenant, session_id)
            record_event(connection, self._access.actor, tenant, AuditAction.SESSION_DELETED, session_id)
            connection.execute(delete(sessions).where(sessions.c.id == session_id))

    def delete_videos(self, session_id: str) -> None:
        """Delete the videos of a session with its proxies and thumbnails, and note their files for removal.

        Results stay, and outputs of stages, by which edits of people and further files are made. To delete them twice
        is no error.

        Raises ``NotFound``, also for a session of keypoints, or ``Conflict`` if a job of the session is unfinished, or
        none has succeeded.
        """
        with self._access.writing() as connection:
            delete_proxies(connection, self._access, session_id)
            tenant = lock_session(connection, self._access, session_id)
            session = self._read(connection, session_id)
            if not any(file.kind == "video" for file in session.files):
                raise NotFound("The capture has keypoints, and no videos.")
            if session.videos_deleted_at is not None:
                return
            of_session = select(jobs.c.id).where(jobs.c.session_id == session_id)
            unfinished = connection.scalar(of_session.where(jobs.c.state.not_in(FINISHED)).limit(1))
            if unfinished is not None:
                raise Conflict(f"The job {unfinished} of this capture is unfinished: wait for its end, or cancel it.")
            if connection.scalar(of_session.where(jobs.c.results_revision.is_not(None)).limit(1)) is None:
                raise Conflict("No job of this capture has succeeded: without videos none could. Delete the capture.")
            kept = [file for file in session.files if file.kind != "video"]
            connection.execute(
                update(sessions)
                .where(sessions.c.id == session_id)
                .values(videos_deleted_at=now(), num_bytes=sum(file.num_bytes for file in kept))
            )
            for file in session.files:
                if file.kind == "video":
                    remove_later(connection, file.key)
            remove_later(connection, thumbnails_prefix(session_id))
            record_event(connection, self._access.actor, tenant, AuditAction.VIDEOS_DELETED, session_id)

    def with_superfluous_videos(self) -> list[str]:
        """Ids of sessions of which a job that does not keep the videos has succeeded, and none is at work."""
        wanted = (
            (jobs.c.session_id == sessions.c.id)
            & jobs.c.results_revision.is_not(None)
            & jobs.c.spec["keep_videos"].as_boolean().is_(false())
        )
        at_work = (jobs.c.session_id == sessions.c.id) & jobs.c.state.not_in(FINISHED) & (jobs.c.kind != "proxies")
        query = select(sessions.c.id, sessions.c.files).where(
            sessions.c.videos_deleted_at.is_(None),
            select(jobs.c.id).where(wanted).exists(),
            ~select(jobs.c.id).where(at_work).exists(),
            self._access.may_reach(sessions),
        )
        with self._access.reading() as connection:
            found = connection.execute(query.order_by(sessions.c.id)).all()
        return [row.id for row in found if any(file["kind"] == "video" for file in row.files)]

    def _read(self, connection: Connection, session_id: str) -> Session:
        query = select(sessions).where(sessions.c.id == session_id, self._access.may_reach(sessions))
        row = existing(connection.execute(query).one_or_none(), "session")
        return read_session(row)

    def _read_capture(self, connection: Connection, session_id: str) -> Capture:
        query = _select_captures().where(sessions.c.id == session_id, self._access.may_reach(sessions))
        row = existing(connection.execute(query).one_or_none(), "session")
        return _read_captures(connection, [row])[0]


def searchable(name: str) -> str:
    """Name as searches compare it: databases fold the case of letters differently, or of ASCII alone."""
    return unicodedata.normalize("NFKC", name).casefold()


def _select_captures() -> Select[Any]:
    """Query of sessions with their reconstructions, for ``_read_captures``; ``jobs`` is the newest one."""
    other = jobs.alias("other")
    is_one = (other.c.session_id == sessions.c.id, other.c.kind == "reconstruction")
    newest = select(other.c.id).where(*is_one).order_by(other.c.id.desc()).limit(1).correlate(sessions)
    num_jobs = select(func.count()).select_from(other).where(*is_one).correlate(sessions)
    with_newest = sessions.outerjoin(
        jobs, and_(jobs.c.session_id == sessions.c.id, jobs.c.id == newest.scalar_subquery())
    )
    of_job = jobs.c.id.label("job_id"), jobs.c.state.label("job_state"), jobs.c.results_revision
    return select(sessions, num_jobs.scalar_subquery().label("num_jobs"), *of_job).select_from(with_newest)


def _read_captures(connection: Connection, rows: Sequence[Row[Any]]) -> list[Capture]:
    made = defaultdict[str, set[str]](set)
    jobs_that_make: dict[str, NewestJob] = {}
    query = (
        select(jobs.c.session_id, jobs.c.id, jobs.c.state, results.c.name)
        .select_from(jobs.outerjoin(results))
        .where(jobs.c.session_id.in_([row.id for row in rows]), jobs.c.kind == "proxies")
        .order_by(jobs.c.id)
    )
    for row in connection.execute(query):
        jobs_that_make[row.session_id] = NewestJob(row.id, JobState(row.state))
        if row.name is not None:
            made[row.session_id].add(row.name)
    waits = awaited_uploads(connection, [row.id for row in rows if row.arrival is not None])
    blurred = _blurred_videos(connection, [row.id for row in rows])
    shown = _shown_until_blurred(connection, list(blurred))
    return [
        Capture(
            read_session(row),
            tuple(waits[row.id]),
            row.num_jobs,
            None if row.job_id is None else _newest_job(row),
            frozenset(made[row.id]),
            jobs_that_make.get(row.id),
            row.id in blurred,
            row.id in blurred and row.id not in shown,
            blurred.get(row.id, frozenset()),
        )
        for row in rows
    ]


def _newest_job(row: Row[Any]) -> NewestJob:
    return NewestJob(row.job_id, job_state(JobState(row.job_state), row.results_revision is not None))


def blurs_faces() -> ColumnElement[bool]:
    """Condition that a job is a reconstruction that blurs faces."""
    return (jobs.c.kind == "reconstruction") & BLURS_FACES


def _blurred_videos(connection: Connection, session_ids: Sequence[str]) -> Mapping[str, frozenset[str]]:
    """Names of the blurred videos that are made, of each session with a job that blurs faces, whatever became of it."""
    is_there = (results.c.kind == BLURRED_KIND) & (jobs.c.state != JobState.EXPIRED)
    query = (
        select(jobs.c.session_id, results.c.name)
        .select_from(jobs.outerjoin(results, (results.c.job_id == jobs.c.id) & is_there))
        .where(jobs.c.session_id.in_(session_ids), blurs_faces())
    )
    names = defaultdict[str, set[str | None]](set)
    for row in connection.execute(query):
        names[row.session_id].add(row.name)
    return {session_id: frozenset(name for name in found if name) for session_id, found in names.items()}


def _shown_until_blurred(connection: Connection, session_ids: Sequence[str]) -> set[str]:
    """Sessions whose jobs that blur faces have all yet to end, and that another reconstruction has shown before."""
    if not session_ids:
        return set()
    is_pending = jobs.c.state.in_(UNFINISHED) & jobs.c.results_revision.is_(None)
    is_done = (jobs.c.kind == "reconstruction") & jobs.c.results_revision.is_not(None)
    query = (
        select(jobs.c.session_id)
        .where(jobs.c.session_id.in_(session_ids))
        .group_by(jobs.c.session_id)
        .having(func.sum(case((blurs_faces() & ~is_pending, 1), else_=0)) == 0)
        .having(func.sum(case((is_done, 1), else_=0)) > 0)
    )
    return set(connection.scalars(query))


def delete_proxies(connection: Connection, access: Access, session_id: str) -> None:
    """Delete the job that makes proxies of a session with its files, before the session is locked.

    No client waits for such a job: a worker stops when it finds its job gone.
    """
    of_session = (jobs.c.session_id == session_id, jobs.c.kind == "proxies", access.may_reach(jobs))
    for job_id in connection.scalars(select(jobs.c.id).where(*of_session).with_for_update()).all():
        remove_later(connection, job_prefix(job_id))
        connection.execute(delete(jobs).where(jobs.c.id == job_id))


def lock_session(connection: Connection, access: Access, session_id: str) -> str:
    """Lock a session until the transaction ends, and return its tenant; ``NotFound`` if there is none.

    A locked session is not deleted, and gets no jobs.
    """
    query = select(sessions.c.tenant).where(sessions.c.id == session_id, access.may_reach(sessions)).with_for_update()
    return existing(connection.scalar(query), "session")


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
