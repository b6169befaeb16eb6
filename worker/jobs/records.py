"""Sessions, jobs and their results: made, read, canceled, retried, deleted."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from sqlalchemy import Connection, Row, delete, func, insert, select
from uuid_utils import uuid7

from worker.jobs.artifacts import stage_key
from worker.jobs.database import Database, now
from worker.jobs.errors import Conflict, NotFinished, NotFound
from worker.jobs.model import (
    FINISHED,
    Change,
    ChunkState,
    Figures,
    InputFile,
    Job,
    JobState,
    Result,
    Session,
    StagePlan,
)
from worker.jobs.rows import jobs_of, result_of, select_jobs, session_of
from worker.jobs.spec import JobSpec
from worker.jobs.tables import artifacts, chunks, events, jobs, results, sessions
from worker.jobs.totals import read_figures
from worker.jobs.transitions import cancel_chunks, lock_job, move_job, note, settle_canceling


class Records:
    """The clients' side of the store. Lists begin with the newest; ``after`` is the last id of the page before."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def create_session(
        self, name: str, files: Sequence[InputFile], preflight: Mapping[str, Any], session_id: str
    ) -> Session:
        """Record a session whose files are in the artifact store."""
        with self._database.writing() as connection:
            connection.execute(
                insert(sessions).values(
                    id=session_id,
                    name=name,
                    created_at=now(),
                    files=[asdict(file) for file in files],
                    preflight=dict(preflight),
                )
            )
            return _session(connection, session_id)

    def session(self, session_id: str) -> Session:
        """A session; ``NotFound`` if there is none."""
        with self._database.reading() as connection:
            return _session(connection, session_id)

    def sessions(self, limit: int = 50, after: str | None = None) -> list[Session]:
        """Sessions, the newest first."""
        query = select(sessions).order_by(sessions.c.id.desc()).limit(limit)
        if after is not None:
            query = query.where(sessions.c.id < after)
        with self._database.reading() as connection:
            return [session_of(row) for row in connection.execute(query)]

    def delete_session(self, session_id: str) -> list[str]:
        """Forget a session and its jobs.

        Returns
        -------
            Keys of what they have in the artifact store.

        Raises
        ------
        NotFound
        Conflict
            A job of it is unfinished.
        """
        of_session = jobs.c.session_id == session_id
        with self._database.writing() as connection:
            _lock_session(connection, session_id)
            unfinished = select(jobs.c.id).where(of_session, jobs.c.state.not_in(FINISHED)).limit(1)
            if connection.execute(unfinished).first() is not None:
                raise Conflict("A job of this session is unfinished.")
            inputs = [file.key for file in _session(connection, session_id).files]
            outputs = select(artifacts.c.output_key).where(artifacts.c.session_id == session_id)
            # What a worker left whose report never came is known by its chunk alone.
            planned = select(chunks.c.output_key).join(jobs).where(of_session)
            left = [stage_key(session_id, key) for key in connection.scalars(outputs.union(planned))]
            shown = connection.scalars(select(results.c.key).join(jobs).where(of_session)).all()
            connection.execute(delete(sessions).where(sessions.c.id == session_id))
        return [*inputs, *left, *shown]

    def create_job(
        self, session_id: str, spec: JobSpec, stages: Sequence[StagePlan], retention_s: float | None = None
    ) -> Job:
        """Queue a job: its first stage is ready. The caller publishes that there is work.

        Parameters
        ----------
        retention_s
            How long its results are kept after its end; ``None``: until somebody deletes them.

        Raises
        ------
        NotFound
            There is no such session.
        ValueError
            There is no stage, or one without chunks: such a job would never end.
        """
        job_id = str(uuid7())
        with self._database.writing() as connection:
            _lock_session(connection, session_id)
            connection.execute(
                insert(jobs).values(
                    id=job_id,
                    session_id=session_id,
                    state=JobState.QUEUED,
                    spec=spec.model_dump(mode="json"),
                    attempt=1,
                    created_at=now(),
                    queued_at=now(),
                    retention_s=retention_s,
                )
            )
            _insert_chunks(connection, job_id, stages)
            note(connection, job_id, "state", JobState.QUEUED)
            return _job(connection, job_id)

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
        ).where(jobs.c.id.in_(job_ids))
        with self._database.reading() as connection:
            return {row.id: Change(row.event, row.done) for row in connection.execute(query)}

    def figures(self) -> Figures:
        """What monitoring wants to know of all jobs."""
        with self._database.reading() as connection:
            return read_figures(connection)

    def job(self, job_id: str) -> Job:
        """A job; ``NotFound`` if there is none."""
        with self._database.reading() as connection:
            return _job(connection, job_id)

    def jobs(self, state: JobState | None = None, limit: int = 50, after: str | None = None) -> list[Job]:
        """Jobs, the newest first."""
        query = select_jobs().order_by(jobs.c.id.desc()).limit(limit)
        if state is not None:
            query = query.where(jobs.c.state == state)
        if after is not None:
            query = query.where(jobs.c.id < after)
        with self._database.reading() as connection:
            return jobs_of(connection, connection.execute(query).all())

    def delete_job(self, job_id: str) -> list[str]:
        """Forget a job; its stages' outputs stay with the session.

        Returns
        -------
            Keys of its results in the artifact store.

        Raises
        ------
        NotFound
        Conflict
            It is unfinished.
        """
        with self._database.writing() as connection:
            _require_finished(_locked_job(connection, job_id), Conflict("The job is unfinished; cancel it first."))
            keys = connection.scalars(select(results.c.key).where(results.c.job_id == job_id)).all()
            connection.execute(delete(jobs).where(jobs.c.id == job_id))
        return list(keys)

    def cancel(self, job_id: str) -> Job:
        """Cancel a job: at once, or as soon as its running chunks are given back. Canceling twice is no error.

        Raises
        ------
        NotFound
        Conflict
            It is finished.
        """
        with self._database.writing() as connection:
            job = _locked_job(connection, job_id)
            if job.state in FINISHED:
                raise Conflict(f"The job is {job.state} already.")
            move_job(connection, job_id, JobState.CANCELING)
            cancel_chunks(connection, job_id, (ChunkState.WAITING, ChunkState.READY))
            settle_canceling(connection, job_id)
            return _job(connection, job_id)

    def retry(self, job_id: str, stages: Sequence[StagePlan]) -> Job:
        """Queue a failed or canceled job again, as its next attempt. The caller publishes that there is work.

        Workers take outputs that are there already (``artifact``) for done.

        Raises
        ------
        NotFound
        Conflict
            It has neither failed nor been canceled.
        """
        with self._database.writing() as connection:
            job = _locked_job(connection, job_id)
            again = {"attempt": job.attempt + 1, "queued_at": now(), "problem": None}
            unended = {"started_at": None, "finished_at": None, "expires_at": None}
            if not move_job(connection, job_id, JobState.QUEUED, **unended, **again):
                raise Conflict(f"Only a failed or canceled job can be retried; this one is {job.state}.")
            connection.execute(delete(results).where(results.c.job_id == job_id))
            connection.execute(delete(chunks).where(chunks.c.job_id == job_id))
            _insert_chunks(connection, job_id, stages)
            return _job(connection, job_id)

    def due(self) -> dict[str, list[str]]:
        """Jobs whose time is over, and the keys of their results in the artifact store."""
        query = (
            select(jobs.c.id, results.c.key)
            .outerjoin(results)
            .where(jobs.c.expires_at < now(), jobs.c.state != JobState.EXPIRED)
            .order_by(jobs.c.id, results.c.name)
        )
        found: dict[str, list[str]] = {}
        with self._database.reading() as connection:
            for job_id, key in connection.execute(query):
                found.setdefault(job_id, []).extend([key] if key else [])
        return found

    def expire(self, job_id: str) -> bool:
        """Say of a job whose time is over that its results are gone; whether it was there and its time was over."""
        with self._database.writing() as connection:
            job = lock_job(connection, job_id)
            is_due = select(jobs.c.id).where(jobs.c.id == job_id, jobs.c.expires_at < now())
            if job is None or connection.execute(is_due).first() is None:
                return False
            return move_job(connection, job_id, JobState.EXPIRED)

    def artifact(self, session_id: str, output_key: str) -> tuple[str, int] | None:
        """SHA-256 and bytes of a chunk's output if any job of the session has finished it."""
        query = select(artifacts.c.sha256, artifacts.c.num_bytes).where(
            artifacts.c.session_id == session_id, artifacts.c.output_key == output_key
        )
        with self._database.reading() as connection:
            row = connection.execute(query).one_or_none()
        return None if row is None else (row.sha256, row.num_bytes)

    def outputs(self, job_id: str, stage: str) -> list[str]:
        """Output keys of a job's stage, in the order of its chunks."""
        query = (
            select(chunks.c.output_key)
            .where(chunks.c.job_id == job_id, chunks.c.stage == stage)
            .order_by(chunks.c.chunk_index)
        )
        with self._database.reading() as connection:
            return list(connection.scalars(query))

    def results(self, job_id: str) -> list[Result]:
        """A finished job's results, by name: none if it has failed.

        Raises
        ------
        NotFound
        NotFinished
        """
        query = select(results).where(results.c.job_id == job_id).order_by(results.c.name)
        with self._database.reading() as connection:
            job = connection.execute(select(jobs).where(jobs.c.id == job_id)).one_or_none()
            if job is None:
                raise NotFound("There is no such job.")
            _require_finished(job, NotFinished("The job is unfinished; its results come with its end."))
            return [result_of(row) for row in connection.execute(query)]

    def result(self, job_id: str, name: str) -> Result:
        """One of ``results``; ``NotFound`` also if there is none of this name."""
        for result in self.results(job_id):
            if result.name == name:
                return result
        raise NotFound("The job has no result of this name.")


def _session(connection: Connection, session_id: str) -> Session:
    row = connection.execute(select(sessions).where(sessions.c.id == session_id)).one_or_none()
    if row is None:
        raise NotFound("There is no such session.")
    return session_of(row)


def _lock_session(connection: Connection, session_id: str) -> None:
    """Keep a session from being deleted, or jobs from being added to it, until the transaction ends."""
    query = select(sessions.c.id).where(sessions.c.id == session_id).with_for_update()
    if connection.execute(query).first() is None:
        raise NotFound("There is no such session.")


def _job(connection: Connection, job_id: str) -> Job:
    found = jobs_of(connection, connection.execute(select_jobs().where(jobs.c.id == job_id)).all())
    if not found:
        raise NotFound("There is no such job.")
    return found[0]


def _locked_job(connection: Connection, job_id: str) -> Row[Any]:
    row = lock_job(connection, job_id)
    if row is None:
        raise NotFound("There is no such job.")
    return row


def _require_finished(job: Row[Any], error: Conflict) -> None:
    if job.state not in FINISHED:
        raise error


def _insert_chunks(connection: Connection, job_id: str, stages: Sequence[StagePlan]) -> None:
    if not stages or not all(stage.chunks for stage in stages):
        raise ValueError("a job needs a stage, and every stage a chunk")
    connection.execute(
        insert(chunks),
        [
            {
                "job_id": job_id,
                "stage_index": stage_index,
                "stage": stage.name,
                "chunk_index": chunk.index,
                "payload": dict(chunk.payload),
                "output_key": chunk.output_key,
                "unit_count": chunk.unit_count,
                "state": ChunkState.READY if stage_index == 0 else ChunkState.WAITING,
            }
            for stage_index, stage in enumerate(stages)
            for chunk in stage.chunks
        ],
    )
