"""Jobs: reconstruct a session, follow it, cancel, retry, delete."""

from functools import partial
from typing import Annotated

import structlog
from fastapi import APIRouter, Body, Query, Request, Response, status

from api import examples
from api.auth import RecordsDep
from api.bodies import SmallBodyRoute
from api.contract import Responses, answer, location, problems, session_body
from api.dependencies import Cursor, JobId, Limit, Services, ServicesDep, SessionId
from api.errors import unprocessable
from api.idempotency import OnceDep
from api.intake import MANIFEST, SPEC, NewSession, callback_errors, spec_errors, take_in
from api.schemas import AttemptList, AttemptOut, JobOut, JobPage
from worker import tracing
from worker.jobs.model import Job, JobState
from worker.jobs.receipts import Answer
from worker.jobs.records import Records
from worker.jobs.removals import remove_files
from worker.jobs.spec import JobSpec
from worker.plan import plan

router = APIRouter(prefix="/v1", tags=["jobs"])
# One of these routes takes JSON; the form has its own limits.
small = APIRouter(prefix="/v1", tags=["jobs"], route_class=SmallBodyRoute)

_log = structlog.get_logger(__name__)

_POLL_AFTER_S = 1
_ONE = answer("Job")
_ACCEPTED: Responses = {
    202: _ONE
    | {
        "headers": {
            "Location": location("job", "/v1/jobs/{job_id}"),
            "Retry-After": {"description": "Seconds until it is worth asking.", "schema": {"type": "integer"}},
        }
    }
}


@small.post(
    "/sessions/{session_id}/jobs",
    operation_id="createJob",
    status_code=status.HTTP_202_ACCEPTED,
    response_model=JobOut,
    responses={**_ACCEPTED, **problems(400, 404, 409, 413, 422)},
)
def create_job(
    session_id: SessionId,
    services: ServicesDep,
    once: OnceDep,
    spec: Annotated[JobSpec, Body(openapi_examples={"default": {"value": examples.DOCUMENTS["spec"]}})] = JobSpec(),  # noqa: B008 - frozen
) -> Response:
    """Reconstruct a session."""

    def act(records: Records) -> Job:
        session = records.session(session_id)
        if errors := [*spec_errors(spec, session.preflight), *callback_errors(spec, services, records)]:
            raise unprocessable(errors)
        stages = plan(session, spec, services.settings.chunk_frames)
        job = records.create_job(session.id, spec, stages, services.settings.retention_s, tracing.current())
        _announce(services, job)
        return job

    return once.run(spec.model_dump(mode="json"), act, _accepted)


@router.post(
    "/jobs",
    operation_id="createSessionAndJob",
    status_code=status.HTTP_202_ACCEPTED,
    response_model=JobOut,
    responses={**_ACCEPTED, **problems(400, 408, 409, 413, 415, 422, 507)},
    openapi_extra=session_body(MANIFEST, SPEC),
)
async def create_session_and_job(request: Request, services: ServicesDep, once: OnceDep) -> Response:
    """Send a session and reconstruct it, in one call: as a form with the files, or as JSON that names uploads."""

    def record(records: Records, new: NewSession) -> Job:
        job = records.create_session_and_job(
            new.name,
            new.files,
            new.preflight,
            new.id,
            new.upload_ids,
            new.spec,
            partial(plan, spec=new.spec, chunk_frames=services.settings.chunk_frames),
            services.settings.retention_s,
            tracing.current(),
            new.metadata,
        )
        _announce(services, job)
        return job

    return await take_in(request, services, once, frozenset({MANIFEST, SPEC}), record, _accepted)


@small.get("/jobs", operation_id="listJobs", responses={200: answer("JobPage"), **problems(422)})
def list_jobs(
    records: RecordsDep,
    state: Annotated[JobState | None, Query(description="Only jobs in this state.")] = None,
    limit: Limit = 50,
    cursor: Cursor = None,
) -> JobPage:
    """List jobs, the newest first."""
    jobs = records.jobs(state=state, limit=limit, after=str(cursor) if cursor else None)
    next_cursor = jobs[-1].id if len(jobs) == limit else None
    return JobPage(jobs=tuple(JobOut.of(job) for job in jobs), next_cursor=next_cursor)


@small.get("/jobs/{job_id}", operation_id="getJob", responses={200: _ONE, **problems(404)})
def get_job(job_id: JobId, records: RecordsDep) -> JobOut:
    """Read a job: its state, its stages, how far they are."""
    return JobOut.of(records.job(job_id))


@small.get(
    "/jobs/{job_id}/attempts",
    operation_id="listAttempts",
    responses={200: answer("AttemptList"), **problems(404)},
)
def list_attempts(job_id: JobId, records: RecordsDep) -> AttemptList:
    """List a job's attempts, with the reason of each failure: of the attempt, and of what was tried again in it."""
    return AttemptList(attempts=tuple(AttemptOut.of(attempt) for attempt in records.attempts(job_id)))


@small.post(
    "/jobs/{job_id}/cancel",
    operation_id="cancelJob",
    status_code=status.HTTP_202_ACCEPTED,
    response_model=JobOut,
    responses={**_ACCEPTED, **problems(400, 404, 409, 422)},
)
def cancel_job(job_id: JobId, once: OnceDep) -> Response:
    """Cancel a job. What runs of it stops within seconds."""
    return once.run(None, lambda records: records.cancel(job_id), _accepted)


@small.post(
    "/jobs/{job_id}/retry",
    operation_id="retryJob",
    status_code=status.HTTP_202_ACCEPTED,
    response_model=JobOut,
    responses={**_ACCEPTED, **problems(400, 404, 409, 422)},
)
def retry_job(job_id: JobId, services: ServicesDep, once: OnceDep) -> Response:
    """Try a failed or canceled job again. What it had finished is not done again."""

    def act(records: Records) -> Job:
        job = records.job(job_id)
        stages = plan(records.session(job.session_id), job.spec, services.settings.chunk_frames)
        job = records.retry(job_id, stages, tracing.current())
        services.queue.publish()
        return job

    return once.run(None, act, _accepted)


@small.delete(
    "/jobs/{job_id}",
    operation_id="deleteJob",
    status_code=status.HTTP_204_NO_CONTENT,
    responses=problems(404, 409),
)
def delete_job(job_id: JobId, services: ServicesDep, records: RecordsDep) -> None:
    """Delete a finished job with its results."""
    records.delete_job(job_id)
    remove_files(services.store, services.artifacts)


def _announce(services: Services, job: Job) -> None:
    """Say that there is work."""
    _log.info("job_created", job=job.id, session=job.session_id)
    # When the broker is away, the reaper makes the message good.
    services.queue.publish()


def _accepted(job: Job) -> Answer:
    headers = {"Location": f"/v1/jobs/{job.id}", "Retry-After": str(_POLL_AFTER_S)}
    return Answer(202, headers, JobOut.of(job).model_dump_json())
