"""Jobs: added, read, canceled, retried, deleted."""

from collections.abc import Collection, Sequence
from dataclasses import asdict
from typing import Any

from sqlalchemy import Connection, Row, delete, func, insert, select
from uuid_utils import uuid7

from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.edits import PeopleEdit, edit_document
from worker.store.database import stored_files
from worker.store.database.access import Access
from worker.store.database.connection import now
from worker.store.database.rows import is_in_state, read_edits, read_job_character, read_jobs, read_making, select_jobs
from worker.store.database.tables import chunks, events, jobs, results
from worker.store.database.transitions import cancel_chunks, delete_visuals_job, move_job, note, settle_canceling
from worker.store.errors import Conflict, EditedMeanwhile, NotFound
from worker.store.files.file_keys import interim_prefix, job_prefix, results_prefix, visuals_prefix
from worker.store.model.character_records import JobCharacter
from worker.store.model.job_records import SIDE_KINDS, Attempt, JobKind, JobRecord, Making, job_config, job_kind
from worker.store.model.states import EDITABLE, FINISHED, RETRYABLE, ChunkState, JobState
from worker.store.model.work import Change, Precedence, StagePlan
from worker.store.repositories.attempts import keep_attempt, read_attempts
from worker.store.repositories.audit import AuditAction, record_event
from worker.store.repositories.calibrations import forget_unmade
from worker.store.repositories.sessions import delete_proxies, lock_session
from worker.store.repositories.work.plans import insert_chunks, plan_changes, require_videos
from worker.store.spec import JobSpec


class Jobs:
    """Jobs of a tenant, or of all tenants."""

    def __init__(self, access: Access) -> None:
        self._access = access

    def reserve_id(self) -> str:
        """Make the id of a job whose copy of a character is about to be stored.

        The copy is removed after a day unless ``add`` is called with the id.
        """
        job_id = str(uuid7())
        with self._access.writing() as connection:
            stored_files.remove_unless_kept(connection, job_prefix(job_id))
        return job_id

    def add(
        self,
        session_id: str,
        spec: JobSpec,
        stages: Sequence[StagePlan],
        retention_s: float | None = None,
        trace: str | None = None,
        making: Making | None = None,
        moved: tuple[str, JobCharacter] | None = None,
    ) -> JobRecord:
        """Queue a job; its first stage is ready. The caller publishes that there is work.

        A job that blurs faces deletes the proxies of its session, which are not blurred.

        Parameters
        ----------
        retention_s
            Time that results are kept after the job's end; ``None``: until they are deleted.
        trace
            W3C traceparent of the request, for the workers.
        making
            See ``worker.store.model.job_records.JobRecord``.
        moved
            Id of the job, made by ``reserve_id``, and the character that it moves, whose copy is stored.

        Raises
        ------
        NotFound
            There is no such session.
        Conflict
            The copy of the character took more than a day, and was removed.
        VideosDeleted
            The session's videos were deleted, and the job needs them.
        QuotaExceeded
        ValueError
            There is no stage, or one without chunks: such a job would never end.
        """
        access = self._access
        job_id, character = moved or (str(uuid7()), None)
        with access.writing() as connection:
            if character is not None:
                access.require_room(connection, stored_bytes=character.file.num_bytes)
                if not stored_files.keep(connection, job_prefix(job_id)):
                    raise Conflict("The copy of the character took too long; send the request again.")
            if job_kind(making) not in SIDE_KINDS:  # which the tenant has not asked for
                access.require_room(connection, unfinished_jobs=1)
            if spec.blur_faces:
                delete_proxies(connection, access, session_id)
            tenant = lock_session(connection, access, session_id)
            require_videos(connection, session_id, stages, job_config(spec, making, character=character))
            connection.execute(
                insert(jobs).values(
                    id=job_id,
                    session_id=session_id,
                    tenant=tenant,
                    state=JobState.QUEUED,
                    spec=spec.model_dump(mode="json"),
                    precedence=Precedence[spec.priority.upper()],
                    attempt=1,
                    created_at=now(),
                    queued_at=now(),
                    retention_s=retention_s,
                    trace=trace,
                    kind=job_kind(making),
                    making=None if making is None else asdict(making),
                    character=None if character is None else asdict(character),
                )
            )
            insert_chunks(connection, job_id, stages)
            note(connection, job_id, "state", JobState.QUEUED)
            record_event(connection, access.actor, tenant, AuditAction.JOB_CREATED, job_id)
            return self._read(connection, job_id)

    def get(self, job_id: str) -> JobRecord:
        """Job with an id; ``NotFound`` if there is none."""
        with self._access.reading() as connection:
            return self._read(connection, job_id)

    def page(
        self,
        state: JobState | None = None,
        limit: int = 50,
        after: str | None = None,
        session_id: str | None = None,
        kind: JobKind | None = None,
    ) -> list[JobRecord]:
        """Jobs, the newest first: all of them, or those in a state or of a session.

        ``after`` is the last id of the page before. Without a ``kind``, all kinds but ``SIDE_KINDS``.
        """
        query = select_jobs().where(self._access.may_reach(jobs)).order_by(jobs.c.id.desc()).limit(limit)
        if state is not None:
            query = query.where(is_in_state(state))
        if session_id is not None:
            query = query.where(jobs.c.session_id == session_id)
        query = query.where(jobs.c.kind.not_in(SIDE_KINDS) if kind is None else jobs.c.kind == kind)
        if after is not None:
            query = query.where(jobs.c.id < after)
        with self._access.reading() as connection:
            return read_jobs(connection, connection.execute(query).all())

    def changes(self, job_ids: Collection[str]) -> dict[str, Change]:
        """Progress of jobs by id, for callers that look for changes; unknown ids are left out."""
        last_event = select(func.max(events.c.id)).where(events.c.job_id == jobs.c.id)
        done_units = select(func.sum(chunks.c.done_units)).where(chunks.c.job_id == jobs.c.id)
        query = select(
            jobs.c.id, last_event.scalar_subquery().label("event"), done_units.scalar_subquery().label("done")
        ).where(jobs.c.id.in_(job_ids), self._access.may_reach(jobs))
        with self._access.reading() as connection:
            return {row.id: Change(row.event, row.done) for row in connection.execute(query)}

    def attempts(self, job_id: str) -> list[Attempt]:
        """Attempts of a job with their failures, the first attempt first; ``NotFound`` without a job."""
        with self._access.reading() as connection:
            return read_attempts(connection, job_row(connection, self._access, job_id))

    def cancel(self, job_id: str) -> JobRecord:
        """Cancel a job: at once, or as soon as its running chunks are given back. Canceling twice is no error.

        Raises ``NotFound``, or ``Conflict`` if the job is finished.
        """
        with self._access.writing() as connection:
            job = job_row(connection, self._access, job_id, lock=True)
            if job.state in FINISHED:
                raise Conflict(f"The job is {job.state} already.")
            if move_job(connection, job_id, JobState.CANCELING):
                record_event(connection, self._access.actor, job.tenant, AuditAction.JOB_CANCELED, job_id)
            cancel_chunks(connection, job_id, (ChunkState.WAITING, ChunkState.READY))
            settle_canceling(connection, job_id)
            return self._read(connection, job_id)

    def retry(self, job_id: str, stages: Sequence[StagePlan], trace: str | None = None) -> JobRecord:
        """Queue a failed or canceled job again, as its next attempt. The caller publishes that there is work.

        Workers reuse outputs that are stored already. ``trace`` as in ``add``. Raises ``NotFound``, ``QuotaExceeded``,
        ``VideosDeleted``, or ``Conflict`` if the job has neither failed nor been canceled.
        """
        with self._access.writing() as connection:
            self._access.require_room(connection, unfinished_jobs=1)
            job = job_row(connection, self._access, job_id, lock=True)
            if job.state in RETRYABLE:
                require_videos(connection, job.session_id, stages, _row_config(job))
            again = {"attempt": job.attempt + 1, "queued_at": now(), "problem": None, "trace": trace, "warnings": []}
            unended = {"started_at": None, "finished_at": None, "expires_at": None}
            if job.state not in RETRYABLE or not move_job(connection, job_id, JobState.QUEUED, **unended, **again):
                raise Conflict(f"Only a failed or canceled job can be retried; this one is {job.state}.")
            record_event(connection, self._access.actor, job.tenant, AuditAction.JOB_RETRIED, job_id)
            keep_attempt(connection, job)
            # Files of an earlier revision stay until this one succeeds.
            connection.execute(delete(results).where(results.c.job_id == job_id, results.c.revision == job.revision))
            connection.execute(delete(chunks).where(chunks.c.job_id == job_id))
            insert_chunks(connection, job_id, stages)
            return self._read(connection, job_id)

    def edit(
        self,
        job_id: str,
        edits: Sequence[PeopleEdit],
        stages: Sequence[StagePlan],
        revision: int | None = None,
        trace: str | None = None,
    ) -> JobRecord:
        """Replace the edits of a job's people and queue it again, as its next revision and attempt.

        Chunks that are done under the same keys stay done. An attempt that has not ended is given up: its running
        chunks lose their leases. The files of the last revision that has succeeded stay until the next one does. The
        caller publishes that there is work. ``stages`` are the plan with these edits, ``revision`` is the one that they
        were made for; ``None``: any. ``trace`` as in ``add``. Raises ``NotFound``, ``QuotaExceeded``, ``VideosDeleted``
        if people would have to be detected again, ``EditedMeanwhile`` if it has another revision, or ``Conflict`` if
        the job is expired or has no people yet.
        """
        with self._access.writing() as connection:
            state = job_row(connection, self._access, job_id).state
            self._access.require_room(connection, unfinished_jobs=int(state in FINISHED))
            job = job_row(connection, self._access, job_id, lock=True)
            if revision is not None and revision != job.revision:
                raise EditedMeanwhile(job.revision, revision)
            if job.people is None:
                raise Conflict("The job has no results yet, so its people can't be edited.")
            require_videos(connection, job.session_id, stages, _row_config(job, tuple(edits), job.revision + 1))
            changed = {
                "edits": [edit_document(edit) for edit in edits],
                "revision": job.revision + 1,
                "precedence": Precedence.EDITS,
                "visuals_old_at": now() if stored_files.has_visuals(connection, job_id) else None,
            }
            again = {"attempt": job.attempt + 1, "queued_at": now(), "problem": None, "trace": trace}
            unended = {"started_at": None, "finished_at": None, "expires_at": None}
            if job.state not in EDITABLE or not move_job(
                connection, job_id, JobState.QUEUED, **unended, **again, **changed
            ):
                raise Conflict(f"The people of a job can be edited until it has expired; this one is {job.state}.")
            record_event(connection, self._access.actor, job.tenant, AuditAction.JOB_EDITED, job_id)
            keep_attempt(connection, job)
            # Files of the last attempt, unless they are listed.
            stored_files.remove_later(connection, interim_prefix(job_id, job.attempt))
            stored_files.remove_unlisted(connection, job_id, results_prefix(job_id, job.revision))
            delete_visuals_job(connection, job_id)
            stored_files.remove_unlisted(connection, job_id, visuals_prefix(job_id, job.revision))
            plan_changes(connection, job_id, stages)
            return self._read(connection, job_id)

    def delete(self, job_id: str) -> None:
        """Delete a job, and note its results for removal; outputs of its stages stay with the session.

        Raises ``NotFound``, or ``Conflict`` if the job is unfinished.
        """
        with self._access.writing() as connection:
            job = job_row(connection, self._access, job_id, lock=True)
            if job.state not in FINISHED:
                raise Conflict("The job is unfinished; cancel it first.")
            delete_visuals_job(connection, job_id)
            stored_files.remove_later(connection, job_prefix(job_id))
            stored_files.forget_answers(connection, job.tenant, job_id)
            record_event(connection, self._access.actor, job.tenant, AuditAction.JOB_DELETED, job_id)
            forget_unmade(connection, job_id)
            connection.execute(delete(jobs).where(jobs.c.id == job_id))

    def _read(self, connection: Connection, job_id: str) -> JobRecord:
        query = select_jobs().where(jobs.c.id == job_id, self._access.may_reach(jobs))
        found = read_jobs(connection, connection.execute(query).all())
        if not found:
            raise NotFound("There is no such job.")
        return found[0]


def _row_config(
    job: Row[Any], edits: tuple[PeopleEdit, ...] | None = None, revision: int | None = None
) -> ReconstructionConfig:
    """Configuration of a job from its row, with its own edits or with others."""
    return job_config(
        JobSpec.model_validate(job.spec),
        read_making(job.kind, job.making),
        read_edits(job.edits) if edits is None else edits,
        job.revision if revision is None else revision,
        read_job_character(job.character),
    )


def job_row(connection: Connection, access: Access, job_id: str, lock: bool = False) -> Row[Any]:
    """Row of a job, locked until the transaction ends if asked for; ``NotFound`` if there is none."""
    query = select(jobs).where(jobs.c.id == job_id, access.may_reach(jobs))
    row = connection.execute(query.with_for_update() if lock else query).one_or_none()
    if row is None:
        raise NotFound("There is no such job.")
    return row
