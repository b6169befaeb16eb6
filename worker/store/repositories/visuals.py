"""Jobs that remake overlay videos, the report and the recording of an edited reconstruction."""

from collections.abc import Sequence
from dataclasses import asdict

from sqlalchemy import insert, select, update
from uuid_utils import uuid7

from pipeline.core.options.job_choices import VisualChoices
from worker.store.database.access import Repository
from worker.store.database.connection import now
from worker.store.database.rows import read_edits, read_jobs, select_jobs
from worker.store.database.tables import jobs, sessions
from worker.store.database.transitions import delete_visuals_job, note
from worker.store.errors import Conflict
from worker.store.model.job_records import JobRecord, job_config
from worker.store.model.states import RETRYABLE, JobState
from worker.store.model.work import Precedence, StagePlan
from worker.store.repositories.audit import AuditAction, record_event
from worker.store.repositories.jobs import job_row
from worker.store.repositories.work.plans import insert_following, require_videos
from worker.store.spec import JobSpec


class Visuals(Repository):
    """Such jobs of a tenant, or of all tenants; a reconstruction has one at most, of its present revision."""

    def add(
        self,
        job_id: str,
        making: VisualChoices,
        stages: Sequence[StagePlan],
        revision: int,
        trace: str | None = None,
    ) -> JobRecord:
        """Queue the job that makes visuals of a reconstruction; chunks that the reconstruction has done are done.

        The caller publishes that there is work.

        ``making``, ``stages``, ``revision``: choices and plan of ``worker.run.planning.plan_visuals``, and the revision
        that they were made for. ``trace``: as in ``Jobs.add``. Returns the new job; the one that is at work already, if
        there is one. Raises ``NotFound``. Raises ``VideosDeleted``: the session's videos were deleted, and an overlay
        video or a recording is to be made. Raises ``Conflict``: files of the reconstruction are being made, it was
        edited since, or nothing is to be remade.
        """
        with self._access.writing() as connection:
            reconstruction = job_row(connection, self._access, job_id, lock=True)
            if reconstruction.state != JobState.SUCCEEDED:
                raise Conflict(f"The job is {reconstruction.state}: its files have to be made first.")
            if reconstruction.revision != revision:
                raise Conflict(f"The job has the revision {reconstruction.revision} now, not {revision}.")
            visuals = select(jobs.c.id, jobs.c.state).where(jobs.c.reconstruction_id == job_id)
            earlier = connection.execute(visuals).one_or_none()
            visuals_id = str(uuid7())
            if earlier is not None and earlier.state not in RETRYABLE:
                if earlier.state == JobState.SUCCEEDED:
                    raise Conflict("Overlay videos, report and recording show the last edits already.")
                visuals_id = earlier.id
            elif earlier is None and reconstruction.visuals_old_at is None:
                raise Conflict(
                    "The job has nothing to show of an earlier revision: overlay videos, a report, or a recording."
                )
            else:
                spec = JobSpec.model_validate(reconstruction.spec)
                config = job_config(spec, making, read_edits(reconstruction.edits), revision)
                require_videos(connection, reconstruction.session_id, stages, config)
                delete_visuals_job(connection, job_id)
                connection.execute(
                    insert(jobs).values(
                        id=visuals_id,
                        session_id=reconstruction.session_id,
                        tenant=reconstruction.tenant,
                        state=JobState.QUEUED,
                        spec=reconstruction.spec | {"callback_url": None},  # of the reconstruction's end
                        precedence=Precedence[spec.priority.upper()],
                        attempt=1,
                        created_at=now(),
                        queued_at=now(),
                        trace=trace,
                        kind="visuals",
                        making=asdict(making),
                        edits=reconstruction.edits,
                        edits_revision=reconstruction.edits_revision,
                        revision=reconstruction.revision,
                        reconstruction_id=job_id,
                        character=reconstruction.character,
                    )
                )
                insert_following(connection, visuals_id, stages, job_id)
                connection.execute(update(jobs).where(jobs.c.id == job_id).values(visuals_old_at=None))
                note(connection, visuals_id, "state", JobState.QUEUED)
                record_event(connection, self._access.actor, reconstruction.tenant, AuditAction.JOB_CREATED, visuals_id)
            (job,) = read_jobs(connection, connection.execute(select_jobs().where(jobs.c.id == visuals_id)).all())
            return job

    def due(self, rest_s: float) -> list[str]:
        """Ids of reconstructions whose last edit is so long ago, and whose visuals are of an earlier revision.

        Without the videos of their sessions nothing is made by itself: reports would lose their pictures.
        """
        query = (
            select(jobs.c.id)
            .join(sessions)
            .where(jobs.c.visuals_old_at <= now() - rest_s, jobs.c.state == JobState.SUCCEEDED)
            .where(sessions.c.videos_deleted_at.is_(None), self._access.may_reach(jobs))
        )
        with self._access.reading() as connection:
            return list(connection.scalars(query.order_by(jobs.c.visuals_old_at, jobs.c.id)))
