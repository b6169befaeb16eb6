"""Jobs: reconstruct a session, follow it, cancel, retry, add files, delete; and the webhook of a job's end."""

import uuid
from functools import partial
from typing import Annotated

from fastapi import APIRouter, FastAPI, Query, Response, status
from starlette.routing import BaseRoute

from api.web.auth import JobViewDep, RecordsDep, ViewerDep
from api.web.contract.description import RETRY_AFTER, Resource, Responses, location, problems
from api.web.dependencies import Cursor, JobId, Limit, Services, ServicesDep, SessionId
from api.web.errors import ApiError, error_item, unprocessable
from api.web.http.bodies.reading import SmallBodyRoute
from api.web.http.conditional import ETAG, NOT_MODIFIED, IfNoneMatch, conditional
from api.web.http.idempotency import Answer, IdempotentRequest, IdempotentRequestDep
from api.web.jobs import queueing
from api.web.jobs.schemas import AttemptList, AttemptOut, JobEnded, JobOut, JobPage
from api.web.sessions.intake import check
from api.web.sessions.receiving import Creation, add_creation
from api.web.sessions.schemas import CAPTURE_FORM
from api.web.sessions.storing import CheckedSession, session_and_job
from pipeline.core.options.rules import installation_problems
from pipeline.core.problems.request_codes import CONFLICT
from worker.run import tracing
from worker.run.planning import has_videos, plan_again, plan_remake, plan_visuals
from worker.store.model.job_records import JobKind
from worker.store.model.states import RETRYABLE, JobState
from worker.store.repositories.work.expiry import remove_files
from worker.store.spec import FilesAdded, JobSpec
from worker.store.tenant_records import TenantRecords

_ENDED = "Receive a job's end"
_GONE: Responses = {410: {"description": "The receiver is gone; the message is not sent again."}}


def _job_ended(message: JobEnded) -> None:
    """The service sends this message to the `callback_url` of the job's spec when the job has ended.

    It repeats the message for a day, until the receiver answers with 2xx or 410.
    """


def declare_webhooks(app: FastAPI) -> None:
    """Declare the webhooks that the service sends."""
    app.webhooks.post("job-ended", operation_id="jobEnded", summary=_ENDED, status_code=204, responses=_GONE)(
        _job_ended
    )


def job_ended_callbacks(operation_id: str, pointer: str) -> list[BaseRoute]:
    """Declare the webhook of an operation; ``pointer`` leads to the receiver's URL in the request's body."""
    router = APIRouter()
    address = f"{{$request.body#{pointer}}}"
    router.post(address, operation_id=operation_id, name="jobEnded", summary=_ENDED, status_code=204, responses=_GONE)(
        _job_ended
    )
    return router.routes


router = APIRouter(prefix="/v1", tags=["jobs"])
# One of these routes takes JSON; the form has its own limits.
small = APIRouter(prefix="/v1", tags=["jobs"], route_class=SmallBodyRoute)

State = Annotated[JobState | None, Query(description="Only jobs in this state.")]
ACCEPTED: Responses = {202: {"headers": {"Location": location("job"), **RETRY_AFTER}}}


@small.post(
    "/sessions/{session_id}/jobs",
    summary="Reconstruct a session",
    status_code=status.HTTP_202_ACCEPTED,
    response_model=JobOut,
    responses={**ACCEPTED, **problems(400, 404, 409, 410, 413, 415, 422, 507)},
    callbacks=job_ended_callbacks("jobEndedOfJob", "/callback_url"),
)
def create_job(
    session_id: SessionId,
    services: ServicesDep,
    idempotent: IdempotentRequestDep,
    spec: JobSpec = JobSpec(),  # noqa: B008 - frozen
) -> Response:
    """Reconstruct a session. If the service still fetches its videos, the job waits for them."""
    if (earlier := idempotent.begin(spec.model_dump(mode="json"))) is not None:
        return earlier
    with idempotent.working():
        session = idempotent.records.sessions.get(session_id, may_wait=True)
        if session.purpose == "calibration":
            message = "The capture was sent for a calibration, and its cameras are not calibrated."
            raise ApiError(CONFLICT, message, hint="Send its videos as a capture with the calibration's id.")
        spec = queueing.with_session_choices(spec, session.preflight)
        limits = queueing.spec_limits(services, idempotent.records, has_videos=has_videos(session))
        preflight = session.preflight if session.arrival is None else None
        if found := queueing.check_spec(spec, preflight, limits):
            raise unprocessable([error_item(problem) for problem in found])
        services.disk.require_room()
        with queueing.queued_job(services, idempotent.records, session, spec) as (work, job):
            answer = idempotent.store(work, queueing.accepted(job))
    return answer.response()


def _add_session_and_job(services: Services, idempotent: IdempotentRequest, checked: CheckedSession) -> Answer:
    """Store the files of a session, and record both or neither."""
    with session_and_job(services, idempotent.records, checked) as (work, job):
        return idempotent.store(work, queueing.accepted(job))


_CREATE = """\
Send a session and reconstruct it, in one call: as a form with the files, or as JSON that names uploads.

The choices of the job, its `callback_url` too, are in `spec`. Generated clients use `createSessionAndJobFromFiles`
and `createSessionAndJobFromUploads`, which do the same with one kind of body each.
"""
add_creation(
    router,
    "/jobs",
    "createSessionAndJob",
    Creation(CAPTURE_FORM, check, _add_session_and_job),
    "Send and reconstruct a session",
    _CREATE,
    lambda sent: job_ended_callbacks(f"jobEndedOf{sent or 'Session'}", "/spec/callback_url"),
    status_code=status.HTTP_202_ACCEPTED,
    response_model=JobOut,
    responses={**ACCEPTED, **problems(400, 408, 409, 410, 413, 415, 422, 507)},
)


@small.get("/jobs", summary="List jobs", responses=problems(422))
def list_jobs(
    records: RecordsDep,
    state: State = None,
    session_id: Annotated[uuid.UUID | None, Query(description="Only jobs of this session.")] = None,
    kind: Annotated[
        JobKind | None, Query(description="Only jobs of this kind; without it all but `proxies` and `visuals`.")
    ] = None,
    limit: Limit = 50,
    cursor: Cursor = None,
) -> JobPage:
    """List jobs, the newest first: all of them, or only jobs of a session or in a state."""
    return _page(records, state, str(session_id) if session_id else None, limit, cursor, kind)


@small.get("/sessions/{session_id}/jobs", summary="List a session's jobs", responses=problems(404, 422))
def list_session_jobs(
    session_id: SessionId, records: RecordsDep, state: State = None, limit: Limit = 50, cursor: Cursor = None
) -> JobPage:
    """List the jobs of a session, the newest first."""
    records.sessions.capture(session_id)
    return _page(records, state, session_id, limit, cursor)


@small.get(
    "/jobs/{job_id}",
    summary="Read a job",
    response_model=JobOut,
    responses={200: {"headers": ETAG}, **NOT_MODIFIED, **problems(404)},
)
def get_job(job_id: JobId, records: JobViewDep, viewer: ViewerDep, if_none_match: IfNoneMatch = None) -> Response:
    """Read a job: its state, its stages, how far they are."""
    job = JobOut.from_job(records.jobs.get(job_id))
    return conditional(job.for_link() if viewer.link else job, if_none_match)


@small.get("/jobs/{job_id}/attempts", summary="List a job's attempts", responses=problems(404))
def list_attempts(job_id: JobId, records: RecordsDep) -> AttemptList:
    """List a job's attempts, with the reason of each failure: of the attempt, and of what was tried again in it."""
    return AttemptList(attempts=tuple(AttemptOut.from_attempt(attempt) for attempt in records.jobs.attempts(job_id)))


@small.post(
    "/jobs/{job_id}/cancel",
    summary="Cancel a job",
    status_code=status.HTTP_202_ACCEPTED,
    response_model=JobOut,
    responses={**ACCEPTED, **problems(400, 404, 409, 422)},
)
def cancel_job(job_id: JobId, services: ServicesDep, idempotent: IdempotentRequestDep) -> Response:
    """Cancel a job. Its running work stops within seconds."""
    return services.disk.using_reserve(lambda: _cancel(services, idempotent, job_id))


def _cancel(services: Services, idempotent: IdempotentRequest, job_id: str) -> Response:
    if (earlier := idempotent.begin(None)) is not None:
        return earlier
    with idempotent.working():
        # Tried again before the key is given back, which may need the reserve too.
        return services.disk.using_reserve(lambda: _canceled(idempotent, job_id)).response()


def _canceled(idempotent: IdempotentRequest, job_id: str) -> Answer:
    with idempotent.records.transaction() as work:
        return idempotent.store(work, queueing.accepted(work.jobs.cancel(job_id)))


@small.post(
    "/jobs/{job_id}/retry",
    summary="Retry a job",
    status_code=status.HTTP_202_ACCEPTED,
    response_model=JobOut,
    responses={**ACCEPTED, **problems(400, 404, 409, 422, 507)},
)
def retry_job(job_id: JobId, services: ServicesDep, idempotent: IdempotentRequestDep) -> Response:
    """Try a failed or canceled job again. Its finished work is not repeated."""
    if (earlier := idempotent.begin(None)) is not None:
        return earlier
    with idempotent.working():
        job = idempotent.records.jobs.get(job_id)
        session = idempotent.records.sessions.get(job.session_id)
        if job.attempt_state in RETRYABLE:  # else the store says why not
            installed = queueing.installed_on_workers(services, has_videos=has_videos(session))
            if missing := [*installation_problems(job.spec.config, installed)]:
                raise unprocessable([error_item(problem, None) for problem in missing])
        services.disk.require_room()
        provider = services.store.workers.provider(job.provider)
        stages = plan_again(session, job, provider)
        with idempotent.records.transaction() as work:
            answer = idempotent.store(work, queueing.accepted(work.jobs.retry(job_id, stages, tracing.current())))
    services.queue.publish()
    return answer.response()


@small.post(
    "/jobs/{job_id}/visuals",
    summary="Make the visuals of a job again",
    status_code=status.HTTP_202_ACCEPTED,
    response_model=JobOut,
    responses={**ACCEPTED, **problems(400, 404, 409, 422, 507)},
)
def make_job_visuals(job_id: JobId, services: ServicesDep, idempotent: IdempotentRequestDep) -> Response:
    """Make overlay videos, report and recording of an edited job again. The answer is the job that makes them.

    It is the same job if it is at work already. A newer edit deletes it. Each file takes the place of the earlier one.
    """
    if (earlier := idempotent.begin(None)) is not None:
        return earlier
    with idempotent.working():
        job = idempotent.records.jobs.get(job_id)
        services.disk.require_room()
        session = idempotent.records.sessions.get(job.session_id)
        making, stages = plan_visuals(session, job)
        with idempotent.records.transaction() as work:
            made = work.visuals.add(job_id, making, stages, job.revision, tracing.current())
            answer = idempotent.store(work, queueing.accepted(made))
    services.queue.publish()
    return answer.response()


@small.post(
    "/jobs/{job_id}/files",
    summary="Add files to a job",
    status_code=status.HTTP_202_ACCEPTED,
    response_model=JobOut,
    responses={**ACCEPTED, **problems(400, 404, 409, 410, 413, 415, 422, 429, 507)},
)
def add_job_files(
    job_id: JobId,
    services: ServicesDep,
    idempotent: IdempotentRequestDep,
    added: FilesAdded = FilesAdded(),  # noqa: B008 - frozen
) -> Response:
    """Add files to a job that has succeeded, without reconstructing again.

    All files follow the present edits of the capture, so an empty body brings those up to date. Report, overlay videos
    and blurred videos are made by a job of their own after the other files, see `visuals_job`. The files that are there
    can be read meanwhile.
    """
    if (earlier := idempotent.begin(added.model_dump(mode="json", exclude_unset=True))) is not None:
        return earlier
    with idempotent.working():
        records = idempotent.records
        job = records.jobs.get(job_id)
        session = records.sessions.get(job.session_id)
        spec = added.added_to(job.spec)
        limits = queueing.spec_limits(services, records, has_videos=has_videos(session))
        # The session was checked, and its errors were ignored or outweighed, when the job was queued.
        if found := queueing.check_spec(spec.model_copy(update={"force": True}), session.preflight, limits):
            raise unprocessable([error_item(problem) for problem in found])
        services.disk.require_room()
        with (
            queueing.copied_character(services, records, added.character, job_id) as moved,
            records.transaction() as work,
        ):
            plan = partial(plan_remake, session)
            remade = work.jobs.remake(job_id, plan, added, moved=moved, trace=tracing.current())
            answer = idempotent.store(work, queueing.accepted(remade))
    services.queue.publish()
    return answer.response()


@small.delete(
    "/jobs/{job_id}", summary="Delete a job", status_code=status.HTTP_204_NO_CONTENT, responses=problems(404, 409)
)
def delete_job(job_id: JobId, services: ServicesDep, records: RecordsDep) -> None:
    """Delete a finished job with its results."""
    services.disk.using_reserve(lambda: records.jobs.delete(job_id))
    services.disk.using_reserve(lambda: remove_files(services.store.removals, services.artifacts))


def _page(
    records: TenantRecords,
    state: JobState | None,
    session_id: str | None,
    limit: int,
    cursor: uuid.UUID | None,
    kind: JobKind | None = None,
) -> JobPage:
    """Build a page of a list of jobs."""
    after = str(cursor) if cursor else None
    jobs = records.jobs.page(state=state, limit=limit, after=after, session_id=session_id, kind=kind)
    next_cursor = jobs[-1].id if len(jobs) == limit else None
    return JobPage(jobs=tuple(JobOut.from_job(job) for job in jobs), next_cursor=next_cursor)


CREATION = Resource(router=router, forms=(CAPTURE_FORM,))
RESOURCE = Resource(router=small)
