"""Beginning of calibrations that a job makes, from videos that were sent or from a session."""

import contextlib
from collections.abc import Iterator

from api.web.calibrations.intake import CheckedCalibration, ReadFile
from api.web.dependencies import POLL_AFTER_S, Services
from api.web.http.idempotency import Answer
from api.web.jobs.schemas import JobOut
from api.web.sessions.intake import stored
from worker.run import tracing
from worker.run.planning import plan_job
from worker.store.model.jobs import JobRecord
from worker.store.model.sessions import Session
from worker.store.model.work import StagePlan
from worker.store.spec import JobSpec
from worker.store.tenant_records import TenantRecords


@contextlib.contextmanager
def begun_calibration(
    services: Services, records: TenantRecords, checked: CheckedCalibration
) -> Iterator[tuple[TenantRecords, JobRecord]]:
    """Store what was sent for a calibration, and record it with the job that makes it; all or nothing.

    The block gets the open transaction and the job. A worker is woken after it.
    """
    content, making, provider = checked.content, checked.choices(), services.store.workers.provider()
    if isinstance(content, ReadFile):
        raise TypeError("a file is a calibration already")
    if isinstance(content, Session):
        services.disk.require_room()
        stages = plan_job(content, JobSpec(), making=making, provider=provider)
        with records.transaction() as work:
            yield work, _begin(services, work, checked, content.id, stages)
    else:
        with stored(services, content) as new:
            stages = plan_job(new, JobSpec(), making=making, provider=provider)
            with records.transaction() as work:
                new.add_to(work, "calibration")
                yield work, _begin(services, work, checked, new.id, stages)
    # When the broker is away, the reaper publishes later.
    services.queue.publish()


def accepted(job: JobRecord) -> Answer:
    """Answer with the job of a calibration."""
    headers = {"Location": f"/v1/jobs/{job.id}", "Retry-After": str(POLL_AFTER_S)}
    return Answer(202, headers, JobOut.of(job).model_dump_json())


def _begin(
    services: Services, work: TenantRecords, checked: CheckedCalibration, session_id: str, stages: tuple[StagePlan, ...]
) -> JobRecord:
    """Queue the job of a calibration in an open transaction, which records both."""
    retention_s = services.settings.retention_s
    job = work.jobs.add(session_id, JobSpec(), stages, retention_s, tracing.current(), checked.choices())
    work.calibrations.begin(job, checked.name)
    return job
