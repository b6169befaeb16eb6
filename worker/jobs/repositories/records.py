"""Sessions, jobs and their results: made, read, canceled, retried, deleted."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict
from types import MappingProxyType
from typing import Any

from sqlalchemy import Connection, Row, delete, func, insert, select
from uuid_utils import uuid7

from worker.jobs.database.connection import now
from worker.jobs.database.quotas import NO_QUOTAS, read_usage, require_room
from worker.jobs.database.rows import jobs_of, result_of, select_jobs, session_of
from worker.jobs.database.tables import chunks, events, jobs, results, sessions
from worker.jobs.database.transitions import cancel_chunks, move_job, note, settle_canceling
from worker.jobs.errors import Conflict, NoResults, NotFinished, NotFound
from worker.jobs.files.artifacts import job_prefix, session_prefix
from worker.jobs.files.removals import keep, remove_later
from worker.jobs.model import (
    FINISHED,
    Attempt,
    Change,
    ChunkState,
    InputFile,
    Job,
    JobState,
    Problem,
    Result,
    Session,
    StagePlan,
    Usage,
    is_worth_a_retry,
)
from worker.jobs.repositories.attempts import attempts_of, keep_attempt
from worker.jobs.repositories.audit import Act, note_deed
from worker.jobs.repositories.deliveries import read_secrets
from worker.jobs.repositories.idempotency_keys import Claim
from worker.jobs.repositories.plans import insert_chunks
from worker.jobs.repositories.uploads import Uploads
from worker.jobs.spec import JobSpec

_NO_METADATA: Mapping[str, Any] = MappingProxyType({})


class Records(Uploads):
    """The clients' side of the store. Lists begin with the newest; ``after`` is the last id of the page before."""

    def answering(self, claim: Claim) -> "Records":
        """The same records, which leave a receipt for what is done by them, once."""
        records = Records(self._database, self._tenant, self._quotas, self._actor)
        records._claim = claim
        return records

    def create_session(
        self,
        name: str,
        files: Sequence[InputFile],
        preflight: Mapping[str, Any],
        session_id: str,
        upload_ids: Collection[str] = (),
        metadata: Mapping[str, Any] = _NO_METADATA,
        record_sha256: str | None = None,
    ) -> Session:
        """Record a session whose files are in the artifact store; ``announce_session`` has made its id.

        Parameters
        ----------
        upload_ids
            Uploads that its files were; they are forgotten.
        metadata
            The client's own; it comes back.
        record_sha256
            Digest of the preflight record in the artifact store; ``None``: the record is read without one.

        Raises
        ------
        Conflict
            Its files took too long, and are gone; or one of the uploads is.
        QuotaExceeded
        """
        with self._database.writing() as connection:
            self._insert_session(connection, name, files, preflight, session_id, upload_ids, metadata, record_sha256)
            session = self._session(connection, session_id)
            self._leave_receipt(connection, session)
            return session

    def create_session_and_job(
        self,
        name: str,
        files: Sequence[InputFile],
        preflight: Mapping[str, Any],
        session_id: str,
        upload_ids: Collection[str],
        spec: JobSpec,
        stages: Sequence[StagePlan],
        retention_s: float | None = None,
        trace: str | None = None,
        metadata: Mapping[str, Any] = _NO_METADATA,
        record_sha256: str | None = None,
    ) -> Job:
        """Both or neither; parameters and errors as of ``create_session`` and ``create_job``."""
        with self._database.writing() as connection:
            self._insert_session(connection, name, files, preflight, session_id, upload_ids, metadata, record_sha256)
            return self._told(connection, self._insert_job(connection, session_id, spec, stages, retention_s, trace))

    def require_room(self, num_bytes: int, unfinished_jobs: int = 0) -> None:
        """Raise ``QuotaExceeded`` if there may be no more session of so many bytes; before they are sent."""
        if self._quotas == NO_QUOTAS:
            return
        more = {"sessions": 1, "stored_bytes": num_bytes, "unfinished_jobs": unfinished_jobs}
        require_room(self._quotas, self.usage(), **more)

    def has_webhook_secret(self) -> bool:
        """Whether messages to the tenant could be signed."""
        with self._database.reading() as connection:
            return bool(read_secrets(connection, self._owner))

    def usage(self) -> Usage:
        """How much the tenant has."""
        with self._database.reading() as connection:
            return read_usage(connection, self._owner)

    def session(self, session_id: str) -> Session:
        """A session; ``NotFound`` if there is none."""
        with self._database.reading() as connection:
            return self._session(connection, session_id)

    def sessions(self, limit: int = 50, after: str | None = None) -> list[Session]:
        """Sessions, the newest first."""
        query = select(sessions).where(self._mine(sessions)).order_by(sessions.c.id.desc()).limit(limit)
        if after is not None:
            query = query.where(sessions.c.id < after)
        with self._database.reading() as connection:
            return [session_of(row) for row in connection.execute(query)]

    def delete_session(self, session_id: str) -> None:
        """Forget a session and its jobs, and note their files for removal.

        Raises
        ------
        NotFound
        Conflict
            A job of it is unfinished.
        """
        with self._database.writing() as connection:
            tenant = self._lock_session(connection, session_id)
            of_session = connection.execute(select(jobs.c.id, jobs.c.state).where(jobs.c.session_id == session_id))
            for job in of_session.all():
                _require_finished(job.state, Conflict("A job of this session is unfinished."))
                remove_later(connection, job_prefix(job.id))
            remove_later(connection, session_prefix(session_id))
            note_deed(connection, self._actor, tenant, Act.SESSION_DELETED, session_id)
            connection.execute(delete(sessions).where(sessions.c.id == session_id))

    def create_job(
        self,
        session_id: str,
        spec: JobSpec,
        stages: Sequence[StagePlan],
        retention_s: float | None = None,
        trace: str | None = None,
    ) -> Job:
        """Queue a job: its first stage is ready. The caller publishes that there is work.

        Parameters
        ----------
        retention_s
            How long its results are kept after its end; ``None``: until somebody deletes them.
        trace
            W3C traceparent of who asks for it, for the workers.

        Raises
        ------
        NotFound
            There is no such session.
        QuotaExceeded
        ValueError
            There is no stage, or one without chunks: such a job would never end.
        """
        with self._database.writing() as connection:
            return self._told(connection, self._insert_job(connection, session_id, spec, stages, retention_s, trace))

    def changes(self, job_ids: Collection[str]) -> dict[str, Change]:
        """How far jobs have come, for whoever looks for what is new; those that are not there are left out."""
        query = (
            select(
                jobs.c.id,
                select(func.max(events.c.id)).where(events.c.job_id == jobs.c.id).scalar_subquery().label("event"),
                select(func.sum(chunks.c.done_units))
                .where(chunks.c.job_id == jobs.c.id)
                .scalar_subquery()
                .label("done"),
            )
        ).where(jobs.c.id.in_(job_ids), self._mine(jobs))
        with self._database.reading() as connection:
            return {row.id: Change(row.event, row.done) for row in connection.execute(query)}

    def job(self, job_id: str) -> Job:
        """A job; ``NotFound`` if there is none."""
        with self._database.reading() as connection:
            return self._job(connection, job_id)

    def jobs(
        self,
        state: JobState | None = None,
        limit: int = 50,
        after: str | None = None,
        session_id: str | None = None,
    ) -> list[Job]:
        """Jobs, the newest first: all of them, or those in a state or of a session."""
        query = select_jobs().where(self._mine(jobs)).order_by(jobs.c.id.desc()).limit(limit)
        if state is not None:
            query = query.where(jobs.c.state == state)
        if session_id is not None:
            query = query.where(jobs.c.session_id == session_id)
        if after is not None:
            query = query.where(jobs.c.id < after)
        with self._database.reading() as connection:
            return jobs_of(connection, connection.execute(query).all())

    def delete_job(self, job_id: str) -> None:
        """Forget a job, and note its results for removal; its stages' outputs stay with the session.

        Raises
        ------
        NotFound
        Conflict
            It is unfinished.
        """
        with self._database.writing() as connection:
            job = self._job_row(connection, job_id, lock=True)
            _require_finished(job.state, Conflict("The job is unfinished; cancel it first."))
            remove_later(connection, job_prefix(job_id))
            note_deed(connection, self._actor, job.tenant, Act.JOB_DELETED, job_id)
            connection.execute(delete(jobs).where(jobs.c.id == job_id))

    def cancel(self, job_id: str) -> Job:
        """Cancel a job: at once, or as soon as its running chunks are given back. Canceling twice is no error.

        Raises
        ------
        NotFound
        Conflict
            It is finished.
        """
        with self._database.writing() as connection:
            job = self._job_row(connection, job_id, lock=True)
            if job.state in FINISHED:
                raise Conflict(f"The job is {job.state} already.")
            if move_job(connection, job_id, JobState.CANCELING):
                note_deed(connection, self._actor, job.tenant, Act.JOB_CANCELED, job_id)
            cancel_chunks(connection, job_id, (ChunkState.WAITING, ChunkState.READY))
            settle_canceling(connection, job_id)
            return self._told(connection, job_id)

    def retry(self, job_id: str, stages: Sequence[StagePlan], trace: str | None = None) -> Job:
        """Queue a failed or canceled job again, as its next attempt. The caller publishes that there is work.

        Workers take outputs that are there already (``artifact``) for done. ``trace`` as in ``create_job``.

        Raises
        ------
        NotFound
        Conflict
            It has neither failed nor been canceled.
        QuotaExceeded
        """
        with self._database.writing() as connection:
            self._require_room(connection, unfinished_jobs=1)
            job = self._job_row(connection, job_id, lock=True)
            again = {"attempt": job.attempt + 1, "queued_at": now(), "problem": None, "trace": trace, "warnings": []}
            unended = {"started_at": None, "finished_at": None, "expires_at": None}
            if not move_job(connection, job_id, JobState.QUEUED, **unended, **again):
                raise Conflict(f"Only a failed or canceled job can be retried; this one is {job.state}.")
            note_deed(connection, self._actor, job.tenant, Act.JOB_RETRIED, job_id)
            keep_attempt(connection, job)
            connection.execute(delete(results).where(results.c.job_id == job_id))
            connection.execute(delete(chunks).where(chunks.c.job_id == job_id))
            insert_chunks(connection, job_id, stages)
            return self._told(connection, job_id)

    def attempts(self, job_id: str) -> list[Attempt]:
        """A job's attempts, the first one first, each with what went wrong in it; ``NotFound`` without a job."""
        with self._database.reading() as connection:
            return attempts_of(connection, self._job_row(connection, job_id))

    def results(self, job_id: str) -> list[Result]:
        """A job's results, by name.

        Raises
        ------
        NotFound
        NotFinished
        NoResults
            It failed or was canceled.
        """
        query = select(results).where(results.c.job_id == job_id).order_by(results.c.name)
        with self._database.reading() as connection:
            job = self._job_row(connection, job_id)
            _require_finished(job.state, NotFinished("The job is unfinished; its results come with its end."))
            found = [result_of(row) for row in connection.execute(query)]
        if not found and job.state != JobState.SUCCEEDED:
            problem = Problem(**job.problem) if job.problem else None
            reason = f"{problem.code}: {problem.detail}" if problem else None
            raise NoResults(job.state, reason, is_worth_a_retry(JobState(job.state), problem))
        return found

    def result(self, job_id: str, name: str) -> Result:
        """One of ``results``; ``NotFound`` also if there is none of this name."""
        for result in self.results(job_id):
            if result.name == name:
                return result
        raise NotFound("The job has no result of this name.")

    def _insert_session(
        self,
        connection: Connection,
        name: str,
        files: Sequence[InputFile],
        preflight: Mapping[str, Any],
        session_id: str,
        upload_ids: Collection[str],
        metadata: Mapping[str, Any],
        record_sha256: str | None,
    ) -> None:
        num_bytes = sum(file.num_bytes for file in files)
        self._use_up(connection, upload_ids)  # first: no byte counts twice
        self._require_room(connection, sessions=1, stored_bytes=num_bytes)
        if not keep(connection, session_prefix(session_id)):
            raise Conflict("The session's files took too long to arrive; send them again.")
        connection.execute(
            insert(sessions).values(
                id=session_id,
                name=name,
                created_at=now(),
                files=[asdict(file) for file in files],
                preflight=dict(preflight),
                client_metadata=dict(metadata),
                num_bytes=num_bytes,
                tenant=self._owner,
                record_sha256=record_sha256,
            )
        )
        note_deed(connection, self._actor, self._owner, Act.SESSION_CREATED, session_id)

    def _insert_job(
        self,
        connection: Connection,
        session_id: str,
        spec: JobSpec,
        stages: Sequence[StagePlan],
        retention_s: float | None,
        trace: str | None,
    ) -> str:
        job_id = str(uuid7())
        self._require_room(connection, unfinished_jobs=1)
        tenant = self._lock_session(connection, session_id)
        connection.execute(
            insert(jobs).values(
                id=job_id,
                session_id=session_id,
                tenant=tenant,
                state=JobState.QUEUED,
                spec=spec.model_dump(mode="json"),
                attempt=1,
                created_at=now(),
                queued_at=now(),
                retention_s=retention_s,
                trace=trace,
            )
        )
        insert_chunks(connection, job_id, stages)
        note(connection, job_id, "state", JobState.QUEUED)
        note_deed(connection, self._actor, tenant, Act.JOB_CREATED, job_id)
        return job_id

    def _session(self, connection: Connection, session_id: str) -> Session:
        query = select(sessions).where(sessions.c.id == session_id, self._mine(sessions))
        row = connection.execute(query).one_or_none()
        if row is None:
            raise NotFound("There is no such session.")
        return session_of(row)

    def _lock_session(self, connection: Connection, session_id: str) -> str:
        """Keep a session from being deleted, or jobs from being added to it, until the transaction ends; its tenant."""
        query = select(sessions.c.tenant).where(sessions.c.id == session_id, self._mine(sessions)).with_for_update()
        tenant: str | None = connection.scalar(query)
        if tenant is None:
            raise NotFound("There is no such session.")
        return tenant

    def _job(self, connection: Connection, job_id: str) -> Job:
        query = select_jobs().where(jobs.c.id == job_id, self._mine(jobs))
        found = jobs_of(connection, connection.execute(query).all())
        if not found:
            raise NotFound("There is no such job.")
        return found[0]

    def _told(self, connection: Connection, job_id: str) -> Job:
        """A job that was made or changed, with the client's receipt for it."""
        job = self._job(connection, job_id)
        self._leave_receipt(connection, job)
        return job

    def _job_row(self, connection: Connection, job_id: str, lock: bool = False) -> Row[Any]:
        query = select(jobs).where(jobs.c.id == job_id, self._mine(jobs))
        row = connection.execute(query.with_for_update() if lock else query).one_or_none()
        if row is None:
            raise NotFound("There is no such job.")
        return row


def _require_finished(state: str, error: Conflict) -> None:
    if state not in FINISHED:
        raise error
