"""Jobs: added, read, canceled, retried, deleted; and their result files."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict, replace
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, delete, func, insert, select
from uuid_utils import uuid7

from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.edits import PeopleEdit, edit_document
from pipeline.core.options.job_choices import BLURRED_KIND
from pipeline.core.records import from_json
from pipeline.run.engine.stage import VIEWER
from worker.store.database import stored_files, transitions
from worker.store.database.access import Access, Repository, existing, newest_first
from worker.store.database.connection import now
from worker.store.database.rows import is_in_state, read, read_jobs, select_jobs
from worker.store.database.tables import chunks, events, jobs, results
from worker.store.errors import Conflict, NoResults, NotFinished, NotFound, VideosDeleted
from worker.store.files.file_keys import interim_prefix, job_prefix, results_prefix, visuals_prefix
from worker.store.model import job_records
from worker.store.model.character_records import JobCharacter
from worker.store.model.session_records import SessionEdits
from worker.store.model.states import FINISHED, REMAKABLE, RETRYABLE, ChunkState, JobState
from worker.store.model.work import Change, Precedence, Remake, StagePlan
from worker.store.repositories.arrivals import wait_for_videos
from worker.store.repositories.audit import AuditAction, record_event
from worker.store.repositories.calibrations import forget_unmade
from worker.store.repositories.sessions import delete_proxies, lock_session, read_session_edits, replace_edits
from worker.store.repositories.work.plans import insert_chunks, plan_changes, require_videos
from worker.store.spec import FilesAdded, JobSpec

_NO_EDITS = SessionEdits()


class Jobs(stored_files.StoringRepository):
    """Jobs of a tenant, or of all tenants."""

    _prefix = staticmethod(job_prefix)

    def add(
        self,
        session_id: str,
        spec: JobSpec,
        stages: Sequence[StagePlan],
        retention_s: float | None = None,
        trace: str | None = None,
        making: job_records.Making | None = None,
        moved: tuple[str, JobCharacter] | None = None,
        edits: SessionEdits = _NO_EDITS,
    ) -> job_records.JobRecord:
        """Queue a job; its first stage is ready. The caller publishes that there is work.

        A job without stages is one of a session whose videos are fetched: they are planned when the videos are there.

        A job that blurs faces deletes the proxies of its session, which are not blurred.

        - ``retention_s``: time that results are kept after the job's end; ``None``: until they are deleted.
        - ``trace``: W3C traceparent of the request, for the workers.
        - ``making``: see ``worker.store.model.job_records.JobRecord``.
        - ``moved``: id of the job, made by ``reserve_id``, and the character that it moves, whose copy is stored.
        - ``edits``: edits of the session that the stages apply.

        Raises ``QuotaExceeded``. Raises ``NotFound``: there is no such session. Raises ``Conflict``: the copy of the
        character took more than a day, and was removed. Or there is no stage, and the videos are not fetched any more.
        Raises ``VideosDeleted``: the session's videos were deleted, and the job needs them. Raises ``ValueError``:
        there is a stage without chunks: such a job would never end.
        """
        access = self._access
        job_id, character = moved or (str(uuid7()), None)
        with access.writing() as connection:
            if character is not None:
                access.require_room(connection, stored_bytes=character.file.num_bytes)
                if not stored_files.keep(connection, job_prefix(job_id)):
                    raise Conflict("The copy of the character took too long; send the request again.")
            if job_records.job_kind(making) not in job_records.SIDE_KINDS:  # which the tenant has not asked for
                access.require_room(connection, unfinished_jobs=1)
            if spec.blur_faces:
                delete_proxies(connection, access, session_id)
            tenant = lock_session(connection, access, session_id)
            config = job_records.job_config(spec, making, edits.edits, character=character)
            require_videos(connection, session_id, stages, config)
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
                    kind=job_records.job_kind(making),
                    making=None if making is None else asdict(making),
                    character=None if character is None else asdict(character),
                    edits=[edit_document(edit) for edit in edits.edits],
                    edits_revision=edits.revision if spec.apply_edits else None,
                )
            )
            transitions.note(connection, job_id, "state", JobState.QUEUED)
            if stages:
                insert_chunks(connection, job_id, stages)
            else:
                wait_for_videos(connection, session_id, job_row(connection, access, job_id))
            record_event(connection, access.actor, tenant, AuditAction.JOB_CREATED, job_id)
            return self._read(connection, job_id)

    def get(self, job_id: str) -> job_records.JobRecord:
        """Job with an id; ``NotFound`` if there is none."""
        with self._access.reading() as connection:
            return self._read(connection, job_id)

    def page(
        self,
        state: JobState | None = None,
        limit: int = 50,
        after: str | None = None,
        session_id: str | None = None,
        kind: job_records.JobKind | None = None,
    ) -> list[job_records.JobRecord]:
        """Jobs, the newest first: all of them, or those in a state or of a session.

        ``after`` is the last id of the page before. Without a ``kind``, all kinds but ``SIDE_KINDS``.
        """
        query = newest_first(select_jobs().where(self._access.may_reach(jobs)), jobs, limit, after)
        if state is not None:
            query = query.where(is_in_state(state))
        if session_id is not None:
            query = query.where(jobs.c.session_id == session_id)
        query = query.where(jobs.c.kind.not_in(job_records.SIDE_KINDS) if kind is None else jobs.c.kind == kind)
        with self._access.reading() as connection:
            return read_jobs(connection, connection.execute(query).all())

    def changes(self, job_ids: Collection[str]) -> dict[str, Change]:
        """Progress of jobs by id, for callers that look for changes; unknown ids are left out."""
        last_event = select(func.max(events.c.id)).where(events.c.job_id == jobs.c.id)
        done_units = select(func.coalesce(func.sum(chunks.c.done_units), 0)).where(chunks.c.job_id == jobs.c.id)
        query = select(
            jobs.c.id, last_event.scalar_subquery().label("event"), done_units.scalar_subquery().label("done")
        ).where(jobs.c.id.in_(job_ids), self._access.may_reach(jobs))
        with self._access.reading() as connection:
            return {row.id: Change(row.event, row.done) for row in connection.execute(query)}

    def attempts(self, job_id: str) -> list[job_records.Attempt]:
        """Attempts of a job with their failures, the first attempt first; ``NotFound`` without a job."""
        with self._access.reading() as connection:
            return transitions.read_attempts(connection, job_row(connection, self._access, job_id))

    def cancel(self, job_id: str) -> job_records.JobRecord:
        """Cancel a job: at once, or as soon as its running chunks are given back. Canceling twice is no error.

        Raises ``NotFound``, or ``Conflict`` if the job is finished.
        """
        with self._access.writing() as connection:
            job = job_row(connection, self._access, job_id, lock=True)
            if job.state in FINISHED:
                raise Conflict(f"The job is {job.state} already.")
            if transitions.move_job(connection, job_id, JobState.CANCELING):
                record_event(connection, self._access.actor, job.tenant, AuditAction.JOB_CANCELED, job_id)
            transitions.cancel_chunks(connection, job_id, (ChunkState.WAITING, ChunkState.READY))
            transitions.settle_canceling(connection, job_id)
            return self._read(connection, job_id)

    def retry(self, job_id: str, stages: Sequence[StagePlan], trace: str | None = None) -> job_records.JobRecord:
        """Queue a failed or canceled job again, as its next attempt. The caller publishes that there is work.

        Workers reuse outputs that are stored already. ``trace`` as in ``add``. Raises ``NotFound``, ``QuotaExceeded``,
        ``VideosDeleted``, or ``Conflict`` if the job has neither failed nor been canceled.
        """
        with self._access.writing() as connection:
            self._access.require_room(connection, unfinished_jobs=1)
            job = job_row(connection, self._access, job_id, lock=True)
            if job.state in RETRYABLE:
                require_videos(connection, job.session_id, stages, _config(self._read(connection, job_id)))
            again = {"attempt": job.attempt + 1, "queued_at": now(), "problem": None, "trace": trace, "warnings": []}
            unended = {"started_at": None, "finished_at": None, "expires_at": None}
            if job.state not in RETRYABLE or not transitions.move_job(
                connection, job_id, JobState.QUEUED, **unended, **again
            ):
                raise Conflict(f"Only a failed or canceled job can be retried; this one is {job.state}.")
            record_event(connection, self._access.actor, job.tenant, AuditAction.JOB_RETRIED, job_id)
            transitions.keep_attempt(connection, job)
            # Files of an earlier revision stay until this one succeeds.
            connection.execute(delete(results).where(results.c.job_id == job_id, results.c.revision == job.revision))
            connection.execute(delete(chunks).where(chunks.c.job_id == job_id))
            insert_chunks(connection, job_id, stages)
            return self._read(connection, job_id)

    def reserve_copy(self, job_id: str) -> str:
        """Prefix for a job's copy of another character, which is removed after a day unless ``remake`` gets it."""
        prefix = f"{job_prefix(job_id)}character/{uuid7()}/"
        with self._access.writing() as connection:
            stored_files.remove_unless_kept(connection, prefix)
        return prefix

    def remake(
        self,
        job_id: str,
        plan: Callable[[job_records.JobRecord], Remake],
        added: FilesAdded | None = None,
        edits: Sequence[PeopleEdit] | None = None,
        edits_revision: int | None = None,
        moved: tuple[str, JobCharacter] | None = None,
        trace: str | None = None,
    ) -> job_records.JobRecord:
        """Make the files of a job again, with the present edits of its session, as its next revision and attempt.

        Chunks that are done under the same keys stay done. An attempt that has not ended is given up: its running
        chunks lose their leases. The files of the last revision that has succeeded stay until the next one does. The
        caller publishes that there is work.

        - ``plan``: plans the changed job, inside the transaction.
        - ``added``: files that it gets besides the files that it has.
        - ``edits``, ``edits_revision``: new edits of the session, and the revision that they were made for; see
          ``replace_edits``. ``None``: the edits stay.
        - ``moved``: prefix of ``reserve_copy``, and the character that the job moves from now on.
        - ``trace``: as in ``add``.

        Raises ``NotFound``, ``QuotaExceeded``, ``EditedMeanwhile``. Raises ``VideosDeleted``: people would have to be
        detected again, or pictures of the videos are asked for. Raises ``Conflict``: the job is no reconstruction, is
        expired, has no people yet, or leaves new edits out.
        """
        access = self._access
        with access.writing() as connection:
            before = self._read(connection, job_id)
            access.require_room(
                connection,
                unfinished_jobs=int(before.attempt_state in FINISHED),
                **({} if moved is None else {"stored_bytes": moved[1].file.num_bytes}),
            )
            if added is not None and added.blur_faces:
                delete_proxies(connection, access, before.session_id)
            tenant = lock_session(connection, access, before.session_id)
            if edits is None:
                newest = read_session_edits(connection, access, before.session_id)
            else:
                newest = replace_edits(connection, access, before.session_id, edits, edits_revision)
            row = job_row(connection, access, job_id, lock=True)
            before = self._read(connection, job_id)
            spec = before.spec if added is None else added.added_to(before.spec)
            if not before.has_people:
                raise Conflict("The job has no people yet.")
            if edits is not None and not spec.apply_edits:
                raise Conflict("The job leaves the edits of the capture out.")
            if moved is not None:
                if not stored_files.keep(connection, moved[0]):
                    raise Conflict("The copy of the character took too long; send the request again.")
                if before.character is not None:
                    stored_files.remove_later(connection, before.character.file.key)
            job = replace(
                before,
                spec=spec,
                edits=newest.edits if spec.apply_edits else (),
                edits_revision=newest.revision if spec.apply_edits else None,
                revision=before.revision + 1,
                character=before.character if moved is None else moved[1],
            )
            remake = plan(job)
            has_new_visuals = _visuals(spec) != _visuals(before.spec)
            if has_new_visuals and remake.needs_videos and not before.has_videos:
                raise VideosDeleted
            require_videos(connection, job.session_id, remake.stages, _config(job))
            changed = {
                "spec": spec.model_dump(mode="json"),
                "edits": [edit_document(edit) for edit in job.edits],
                "edits_revision": job.edits_revision,
                "revision": job.revision,
                "character": None if job.character is None else asdict(job.character),
                "precedence": Precedence.EDITS,
                # New ones are made as soon as the other files are there, the others when the edits rest.
                "visuals_old_at": (0.0 if has_new_visuals else now()) if remake.has_visuals else None,
            }
            again = {"attempt": row.attempt + 1, "queued_at": now(), "problem": None, "trace": trace}
            unended = {"started_at": None, "finished_at": None, "expires_at": None}
            if row.state not in REMAKABLE or not transitions.move_job(
                connection, job_id, JobState.QUEUED, **unended, **again, **changed
            ):
                raise Conflict(f"The files of a job are made again until it has expired; this one is {row.state}.")
            record_event(connection, access.actor, tenant, AuditAction.FILES_REMADE, job_id)
            transitions.keep_attempt(connection, row)
            # Files of the last attempt, unless they are listed.
            stored_files.remove_later(connection, interim_prefix(job_id, row.attempt))
            stored_files.remove_unlisted(connection, job_id, results_prefix(job_id, row.revision))
            transitions.delete_visuals_job(connection, job_id)
            stored_files.remove_unlisted(connection, job_id, visuals_prefix(job_id, row.revision))
            plan_changes(connection, job_id, remake.stages)
            return self._read(connection, job_id)

    def delete(self, job_id: str) -> None:
        """Delete a job, and note its results for removal; outputs of its stages stay with the session.

        Raises ``NotFound``, or ``Conflict`` if the job is unfinished.
        """
        with self._access.writing() as connection:
            job = job_row(connection, self._access, job_id, lock=True)
            if job.state not in FINISHED:
                raise Conflict("The job is unfinished; cancel it first.")
            transitions.delete_visuals_job(connection, job_id)
            stored_files.remove_later(connection, job_prefix(job_id))
            stored_files.forget_answers(connection, job.tenant, job_id)
            record_event(connection, self._access.actor, job.tenant, AuditAction.JOB_DELETED, job_id)
            forget_unmade(connection, job_id)
            connection.execute(delete(jobs).where(jobs.c.id == job_id))

    def _read(self, connection: Connection, job_id: str) -> job_records.JobRecord:
        query = select_jobs().where(jobs.c.id == job_id, self._access.may_reach(jobs))
        return existing(next(iter(read_jobs(connection, connection.execute(query).all())), None), "job")


def _config(job: job_records.JobRecord) -> ReconstructionConfig:
    return job_records.job_config(job.spec, job.making, job.edits, job.revision, job.character)


def _visuals(spec: JobSpec) -> tuple[bool, ...]:
    """Visuals that a spec asks for, and whether heads are blurred in them."""
    return spec.overlay, spec.report, "rerun" in spec.exports, spec.blur_faces


def job_row(connection: Connection, access: Access, job_id: str, lock: bool = False) -> Row[Any]:
    """Row of a job, locked until the transaction ends if asked for; ``NotFound`` if there is none."""
    query = select(jobs).where(jobs.c.id == job_id, access.may_reach(jobs))
    return existing(connection.execute(query.with_for_update() if lock else query).one_or_none(), "job")


class Results(Repository):
    """Results of the jobs of a tenant, or of all tenants."""

    def downloads(self, job_id: str) -> list[job_records.Result]:
        """Results of a job for downloads, by name, without the files of viewers; errors like ``all``."""
        return [result for result in self.all(job_id) if result.kind != VIEWER]

    def all(self, job_id: str) -> list[job_records.Result]:
        """Results of a job, by name.

        Raises ``NotFound``, ``NotFinished`` if no revision of the job has succeeded yet, or ``NoResults`` if it failed
        or was canceled before.
        """
        query = select(results).where(results.c.job_id == job_id).order_by(results.c.name)
        with self._access.reading() as connection:
            job = job_row(connection, self._access, job_id)
            if job.results_revision is None and job.state not in FINISHED:
                raise NotFinished("The job is unfinished; its results come with its end.")
            found = [read(job_records.Result, row) for row in connection.execute(query)]
        if not found and job.results_revision is None:
            problem = from_json(job_records.JobProblem, job.problem)
            reason = f"{problem.code}: {problem.detail}" if problem else None
            raise NoResults(job.state, reason, job_records.is_worth_a_retry(JobState(job.state), problem))
        return found

    def listed(self, job_id: str, name: str) -> job_records.Result | None:
        """Result of a job by name, in whatever state the job is; ``None`` if there is none of this name.

        Raises ``NotFound`` if there is no such job.
        """
        query = select(results).where(results.c.job_id == job_id, results.c.name == name)
        with self._access.reading() as connection:
            job_row(connection, self._access, job_id)
            row = connection.execute(query).one_or_none()
        return None if row is None else read(job_records.Result, row)

    def proxy(self, session_id: str, name: str) -> job_records.Result | None:
        """Proxy of a session by its name, as soon as it is made; ``None`` before, and without a session."""
        return self._newest(session_id, name, jobs.c.kind == "proxies")

    def blurred(self, session_id: str, name: str) -> job_records.Result | None:
        """Blurred video of a session by its name, of the newest job that has made it; ``None`` if none has."""
        is_blurred = (results.c.kind == BLURRED_KIND) & (jobs.c.state != JobState.EXPIRED)
        return self._newest(session_id, name, is_blurred)

    def _newest(self, session_id: str, name: str, condition: ColumnElement[bool]) -> job_records.Result | None:
        chosen = (jobs.c.session_id == session_id, results.c.name == name, self._access.may_reach(jobs), condition)
        query = select(results).join(jobs).where(*chosen).order_by(jobs.c.id.desc()).limit(1)
        with self._access.reading() as connection:
            row = connection.execute(query).one_or_none()
        return None if row is None else read(job_records.Result, row)

    def get(self, job_id: str, name: str) -> job_records.Result:
        """Result of a job by name; errors like ``all``, and ``NotFound`` if there is none of this name."""
        for result in self.all(job_id):
            if result.name == name:
                return result
        raise NotFound("The job has no result of this name.")
