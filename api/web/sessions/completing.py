"""Sessions whose videos were fetched: their files are checked and stored, and their jobs begin or fail."""

import json
from functools import partial
from pathlib import Path

import structlog
from starlette.concurrency import run_in_threadpool

from api.web.calibrations.intake import CALIBRATION_FORM, check_calibration
from api.web.calibrations.schemas import UploadedCalibration
from api.web.dependencies import Services
from api.web.errors import ApiError, ErrorItem, as_api_error
from api.web.http.bodies.validation import NO_PLACES
from api.web.jobs.queueing import SpecLimits, check_spec, planned, queue_proxies, spec_limits
from api.web.sessions.intake import check
from api.web.sessions.receiving import Sent, spool_folder
from api.web.sessions.schemas import SESSION_FORM, UploadedSession
from api.web.sessions.storing import CheckedSession, new_session, put_files
from worker.store.files.file_keys import session_prefix
from worker.store.model.job_records import JobProblem, JobRecord, job_config
from worker.store.model.session_records import FetchedSession, Session
from worker.store.model.work import StagePlan
from worker.store.tenant_records import TenantRecords

_log = structlog.get_logger(__name__)

# Statuses of a busy service and of outages: the check is due again.
_UNDECIDED = frozenset({429, 503})


async def complete(services: Services, arrival: FetchedSession) -> None:
    """Check and store the files of a session, or record everything that is wrong with them."""
    records = services.store.tenant(arrival.tenant, services.quotas)
    try:
        async with spool_folder(services.settings.spool_dir) as folder:
            checked = await _checked(services, records, arrival, folder)
            await run_in_threadpool(_store, services, records, arrival, checked)
        _log.info("session_completed", session=arrival.session_id)
    except Exception as error:
        answer = as_api_error(error)
        if answer.status >= 500:
            _log.exception("session_not_completed", session=arrival.session_id)
        if answer.status in _UNDECIDED:
            return
        try:
            await run_in_threadpool(_fail, services, records, arrival, answer)
        except Exception:  # it is due again when its lease ends
            _log.exception("session_failure_not_recorded", session=arrival.session_id)


async def _checked(services: Services, records: TenantRecords, arrival: FetchedSession, folder: Path) -> CheckedSession:
    body = json.dumps(arrival.body)
    if arrival.purpose == "capture":
        sent = Sent(folder, SESSION_FORM, UploadedSession.model_validate_json(body), None, NO_PLACES)
        return await check(arrival.tenant, services, records, sent)
    sent = Sent(folder, CALIBRATION_FORM, UploadedCalibration.model_validate_json(body), None, NO_PLACES)
    content = (await check_calibration(arrival.tenant, services, records, sent)).content
    if not isinstance(content, CheckedSession):
        raise TypeError("only videos are fetched")
    return content


def _store(services: Services, records: TenantRecords, arrival: FetchedSession, checked: CheckedSession) -> None:
    """Store the files of a session, and record them together with the plans of its jobs."""
    new = new_session(services, checked, arrival.session_id)
    put_files(services, checked, new)
    provider = services.store.workers.provider()
    with records.transaction() as work:
        limits = spec_limits(services, work, has_videos=True)
        found = new.files, new.preflight, new.record_sha256, new.chunk_frames
        is_first = work.arrivals.complete(new.id, *found, partial(_plan, services, limits, provider))
        if is_first and work.jobs.page(session_id=new.id, kind="reconstruction", limit=1):
            queue_proxies(work, new)
    services.queue.publish()
    for upload in arrival.uploads:
        services.uploads.remove(upload.id)


def _plan(
    services: Services, limits: SpecLimits, provider: str, session: Session, job: JobRecord
) -> tuple[StagePlan, ...] | JobProblem:
    """Plan a job that waited for its session, or say why it can't be done."""
    if job.making is None and (problems := check_spec(job.spec, session.preflight, limits)):
        first = problems[0]
        message = " ".join(problem.message for problem in problems)
        return JobProblem(first.code, message, camera=first.camera, hint=first.hint)
    config = job_config(job.spec, job.making, job.edits, character=job.character)
    try:
        return planned(services, session, config, provider, job.character)
    except ApiError as error:
        return JobProblem(error.code, error.detail, hint=error.hint, retryable=error.retryable)


def _fail(services: Services, records: TenantRecords, arrival: FetchedSession, answer: ApiError) -> None:
    errors = answer.errors or (ErrorItem(code=answer.code, message=answer.detail, hint=answer.hint),)
    if records.arrivals.fail(arrival.session_id, [error.model_dump(mode="json") for error in errors]):
        _log.info("session_failed", session=arrival.session_id, codes=sorted({error.code for error in errors}))
        services.artifacts.delete_prefix(session_prefix(arrival.session_id))
        for upload in arrival.uploads:
            services.uploads.remove(upload.id)
