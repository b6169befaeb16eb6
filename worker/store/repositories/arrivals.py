"""Arrivals: sessions whose videos the service fetches, until their files are checked, and the jobs that wait for them.

One API process checks the files of a session at a time: it renews the time at which the check is due again.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from sqlalchemy import Connection, Row, delete, select, update

from pipeline.capture.preflight_record import Preflight
from pipeline.core.problems.finding_codes import SESSION_UNUSABLE, VIDEOS_FETCHING
from worker.store.database.access import Repository
from worker.store.database.connection import now
from worker.store.database.rows import read_jobs, read_session, select_jobs
from worker.store.database.tables import jobs, sessions, uploads
from worker.store.database.transitions import lock_job, move_job, set_waiting
from worker.store.errors import Conflict
from worker.store.model.job_records import JobProblem, JobRecord, SessionError
from worker.store.model.session_records import FetchedSession, InputFile, Session
from worker.store.model.states import UNFINISHED, JobState
from worker.store.model.work import StagePlan
from worker.store.repositories.uploads import awaited_uploads
from worker.store.repositories.work.plans import insert_chunks

PlanJob = Callable[[Session, JobRecord], Sequence[StagePlan] | JobProblem]
"""Plan of a job of a session whose files are there, or the reason why it fails."""

_FETCHING = JobProblem(
    VIDEOS_FETCHING, "The service fetches the videos of the capture.", hint="The job starts when they are there."
)


class Arrivals(Repository):
    """Arrivals of a tenant, or of all tenants."""

    def reserve(self, session_id: str, upload_ids: Collection[str]) -> None:
        """Reserve uploads for a session of the same transaction; ``Conflict`` if it can't have one of them.

        Files that clients sent are complete.
        """
        is_free = uploads.c.id.in_(upload_ids) & uploads.c.session_id.is_(None) & self._access.may_reach(uploads)
        with self._access.writing() as connection:
            values = {"session_id": session_id, "fetched_bytes": uploads.c.num_bytes}
            reserved = connection.execute(update(uploads).where(is_free).values(**values))
            if reserved.rowcount != len(upload_ids):
                raise Conflict("An upload was deleted, or used for another capture, in the meantime.")

    def due(self) -> list[FetchedSession]:
        """Sessions whose fetches have all ended, and whose files no process checks; the oldest first."""
        is_fetching = uploads.c.fetch_due_at.is_not(None) & (uploads.c.expires_at >= now())
        fetching = select(uploads.c.id).where(uploads.c.session_id == sessions.c.id, is_fetching).exists()
        is_due = (sessions.c.arrival_due_at <= now()) & self._access.may_reach(sessions)
        with self._access.reading() as connection:
            rows = connection.execute(select(sessions).where(is_due, ~fetching).order_by(sessions.c.id)).all()
            found = awaited_uploads(connection, [row.id for row in rows])
            return [FetchedSession(row.id, row.tenant, row.purpose, row.arrival, tuple(found[row.id])) for row in rows]

    def claim(self, session_id: str, lease_s: float) -> bool:
        """Take the check of a session, which is due again after ``lease_s``; return whether no process was faster."""
        is_due = (sessions.c.id == session_id) & (sessions.c.arrival_due_at <= now())
        with self._access.writing() as connection:
            claimed = connection.execute(update(sessions).where(is_due).values(arrival_due_at=now() + lease_s))
            return claimed.rowcount == 1

    def renew(self, session_ids: Collection[str], lease_s: float, keep_s: float) -> None:
        """Keep the checks of sessions, and the uploads that they wait for, for longer."""
        chosen = sessions.c.id.in_(session_ids), sessions.c.arrival_due_at.is_not(None)
        with self._access.writing() as connection:
            connection.execute(update(sessions).where(*chosen).values(arrival_due_at=now() + lease_s))
            kept = update(uploads).where(uploads.c.session_id.in_(session_ids))
            connection.execute(kept.values(expires_at=now() + keep_s))

    def complete(
        self,
        session_id: str,
        files: Sequence[InputFile],
        preflight: Preflight,
        record_sha256: str,
        chunk_frames: int,
        plan: PlanJob,
    ) -> bool:
        """Record the files of a session, which are in the artifact store, in place of its uploads; begin its jobs.

        Returns whether it still waited for them. Raises ``QuotaExceeded``.
        """
        num_bytes = sum(file.num_bytes for file in files)
        with self._access.writing() as connection:
            if not self._end(connection, session_id):
                return False
            self._access.require_room(connection, stored_bytes=num_bytes)
            found = {"record_sha256": record_sha256, "num_bytes": num_bytes, "chunk_frames": chunk_frames}
            found |= {"files": [asdict(file) for file in files], "preflight": preflight.to_json()}
            stored = update(sessions).where(sessions.c.id == session_id).values(**found).returning(*sessions.c)
            session = read_session(connection.execute(stored).one())
            for row in _lock_waiting(connection, session_id):
                (job,) = read_jobs(connection, connection.execute(select_jobs().where(jobs.c.id == row.id)).all())
                stages = plan(session, job)
                if isinstance(stages, JobProblem):
                    move_job(connection, job.id, JobState.FAILED, problem=asdict(stages))
                else:
                    insert_chunks(connection, job.id, stages)
                    set_waiting(connection, row, None)
            return True

    def fail(self, session_id: str, errors: Sequence[Mapping[str, Any]]) -> bool:
        """Record why the files of a session can't be used, and end its jobs; return whether it waited for them.

        ``errors`` are errors as the web API describes them.
        """
        listed = tuple(
            SessionError(error["code"], error["message"], *map(error.get, ("camera", "hint", "file")))
            for error in errors
        )
        problem = JobProblem(SESSION_UNUSABLE, "The videos of the capture can't be used.", errors=listed)
        with self._access.writing() as connection:
            if not self._end(connection, session_id):
                return False
            values = {"errors": [dict(error) for error in errors]}
            connection.execute(update(sessions).where(sessions.c.id == session_id).values(**values))
            for row in _lock_waiting(connection, session_id):
                move_job(connection, row.id, JobState.FAILED, problem=asdict(problem))
            return True

    def _end(self, connection: Connection, session_id: str) -> bool:
        """End the arrival of a session, which is locked until the transaction ends; its uploads are used."""
        is_awaited = (sessions.c.id == session_id) & sessions.c.arrival_due_at.is_not(None)
        ended = {"arrival": None, "arrival_due_at": None}
        if connection.execute(update(sessions).where(is_awaited).values(**ended)).rowcount == 0:
            return False
        connection.execute(delete(uploads).where(uploads.c.session_id == session_id))
        return True


def wait_for_videos(connection: Connection, session_id: str, job: Row[Any]) -> None:
    """Let a new job of a locked session wait for its videos; ``Conflict`` if they are not fetched any more."""
    if connection.scalar(select(sessions.c.arrival_due_at).where(sessions.c.id == session_id)) is None:
        raise Conflict("The videos of the capture have come just now; send the request again.")
    set_waiting(connection, job, _FETCHING)


def _lock_waiting(connection: Connection, session_id: str) -> list[Row[Any]]:
    """Lock the jobs of a locked session that have not ended."""
    query = select(jobs.c.id).where(jobs.c.session_id == session_id, jobs.c.state.in_(UNFINISHED)).order_by(jobs.c.id)
    return [row for job_id in connection.scalars(query).all() if (row := lock_job(connection, job_id)) is not None]
