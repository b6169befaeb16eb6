"""Queueing of new reconstructions: their plans, the jobs of proxies beside them, sessions that are sent with a job."""

import contextlib
from collections.abc import Iterator

import structlog

from api.web.characters.copies import copied_character
from api.web.dependencies import Services
from api.web.jobs.space import require_space
from api.web.sessions.intake import CheckedSession, NewSession, stored
from pipeline.core.options.job_choices import ProxyChoices
from worker.run.planning import has_videos, plan_job
from worker.run.telemetry import tracing
from worker.store.model.characters import JobCharacter
from worker.store.model.jobs import JobRecord
from worker.store.model.sessions import Session
from worker.store.model.work import StagePlan
from worker.store.spec import JobSpec
from worker.store.tenant_records import TenantRecords

_log = structlog.get_logger(__name__)


def planned(
    services: Services, session: Session | NewSession, spec: JobSpec, moved: tuple[str, JobCharacter] | None
) -> tuple[StagePlan, ...]:
    """Plan of a new reconstruction; ``moved`` is the copy of its character with the id of the job."""
    return plan_job(
        session,
        spec,
        character=None if moved is None else moved[1],
        provider=services.store.workers.provider(),
    )


@contextlib.contextmanager
def session_and_job(
    services: Services, records: TenantRecords, checked: CheckedSession
) -> Iterator[tuple[TenantRecords, JobRecord]]:
    """Store the files of a session and record it with its job; both or neither.

    The block gets the open transaction and the job. A worker is woken after it.
    """
    spec = checked.spec
    with copied_character(services, records, spec) as moved:
        require_space(services, checked.preflight, spec, None if moved is None else moved[1])
        with stored(services, checked) as new:
            stages = planned(services, new, spec, moved)
            with records.transaction() as work:
                new.add_to(work)
                retention_s = services.settings.retention_s
                job = work.jobs.add(new.id, spec, stages, retention_s, tracing.current(), moved=moved)
                queue_proxies(work, services, new)
                yield work, job
    announce(services, job)


def queue_proxies(work: TenantRecords, services: Services, session: Session | NewSession) -> None:
    """Queue the job that makes a session's proxies, in an open transaction, unless there is one or none is needed.

    Of a session with a job that blurs faces, only blurred videos are shown, and of deleted videos there are no copies.
    """
    cameras = tuple(camera.name for camera in session.preflight.cameras if camera.media_type is None)
    if not cameras or not has_videos(session) or work.jobs.page(session_id=session.id, kind="proxies", limit=1):
        return
    capture = work.sessions.capture(session.id)
    if capture.is_blurred or capture.session.videos_deleted_at is not None:
        return
    making = ProxyChoices(cameras)
    stages = plan_job(session, JobSpec(), making=making)
    work.jobs.add(session.id, JobSpec(), stages, None, tracing.current(), making)


def announce(services: Services, job: JobRecord) -> None:
    """Wake a worker for a new job."""
    _log.info("job_created", job=job.id, session=job.session_id)
    # When the broker is away, the reaper publishes later.
    services.queue.publish()
