"""People of a job: who was found, and the edits that put them right."""

from typing import Annotated

from fastapi import APIRouter, Body, Response, status

from api.web.auth import RecordsDep
from api.web.contract.description import RETRY_AFTER, Resource, Responses, answer, location, problems
from api.web.contract.examples import JOB_ID
from api.web.dependencies import POLL_AFTER_S, JobId, ServicesDep
from api.web.errors import ApiError, ErrorItem, unprocessable
from api.web.http.bodies.reading import SmallBodyRoute
from api.web.http.conditional import ETAG, NOT_MODIFIED, IfMatch, IfNoneMatch, conditional_by, entity_tag, matches
from api.web.jobs.schemas import JobOut
from api.web.people import examples
from api.web.people.schemas import PeopleEdits, PeopleOut, frames_of
from pipeline.core.errors import InputError
from pipeline.core.options.edits import MAX_PIECES, PersonSpan, apply_edits
from pipeline.core.problems.requests import CONFLICT
from worker.run import tracing
from worker.run.planning import plan_job
from worker.store.model.jobs import JobRecord

router = APIRouter(prefix="/v1/jobs", tags=["jobs"], route_class=SmallBodyRoute)

_ACCEPTED: Responses = {
    202: answer("Job") | {"headers": {"Location": location("job", f"/v1/jobs/{JOB_ID}"), **RETRY_AFTER}},
}


@router.get(
    "/{job_id}/people",
    operation_id="getJobPeople",
    summary="Read a job's people",
    response_model=PeopleOut,
    responses={200: answer("People") | {"headers": ETAG}, **NOT_MODIFIED, **problems(404, 409)},
)
def get_job_people(job_id: JobId, records: RecordsDep, if_none_match: IfNoneMatch = None) -> Response:
    """Read who was found, the edits, and who there is after them. The entity tag changes with the edits."""
    job = records.jobs.get(job_id)
    found = _found(job)
    return conditional_by(_tag(job), lambda: PeopleOut.of(job, found), if_none_match)


@router.patch(
    "/{job_id}/people",
    operation_id="editJobPeople",
    summary="Edit a job's people",
    status_code=status.HTTP_202_ACCEPTED,
    response_model=JobOut,
    responses={**_ACCEPTED, **problems(400, 404, 409, 413, 415, 422, 429, 507)},
)
def edit_job_people(
    job_id: JobId,
    edits: Annotated[PeopleEdits, Body(openapi_examples={"default": {"value": examples.EDITS}})],
    services: ServicesDep,
    records: RecordsDep,
    if_match: IfMatch = None,
) -> Response:
    """Replace the edits of a job's people; the files are made anew, without looking for joints again.

    With `If-Match`, only if nobody changed the edits since. The edits may be changed again before their files are made:
    work for an earlier list is given up. The files of the last finished revision can be read until then; the job's
    `results_revision` names it.
    """
    job = records.jobs.get(job_id)
    found = _found(job)
    if if_match is not None and not matches(if_match, _tag(job)):
        raise ApiError(
            CONFLICT,
            "The edits have changed since this version.",
            hint="Read the people again, then send the edits with their present ETag.",
        )
    try:
        apply_edits(found, edits.edits, frames_of(job), MAX_PIECES)
    except InputError as error:
        raise unprocessable(
            [
                ErrorItem(code=problem.code, message=problem.message, pointer=f"/{problem.field}", hint=problem.hint)
                for problem in error.problems
            ]
        ) from error
    services.disk.require_room()
    session = records.sessions.get(job.session_id)
    stages = plan_job(
        session,
        job.spec,
        edits=edits.edits,
        revision=job.revision + 1,
        character=job.character,
        provider=job.provider,
    )
    with records.transaction() as work:
        # Without `If-Match` the newest list wins, also over one that came meanwhile.
        revision = None if if_match is None else job.revision
        edited = work.jobs.edit(job_id, edits.edits, stages, revision, tracing.current())
    services.queue.publish()
    return Response(
        JobOut.of(edited).model_dump_json(),
        status_code=status.HTTP_202_ACCEPTED,
        headers={"Location": f"/v1/jobs/{job_id}", "Retry-After": str(POLL_AFTER_S)},
        media_type="application/json",
    )


def _tag(job: JobRecord) -> str:
    """Entity tag of a job's people; the edits are not applied for it."""
    return entity_tag(job.revision, job.edits, job.people, frames_of(job))


def _found(job: JobRecord) -> tuple[PersonSpan, ...]:
    if job.people is None:
        raise ApiError(
            CONFLICT,
            "The job has no people yet.",
            hint="Wait until the job has succeeded. Reconstruct the session again if an older version did it.",
        )
    return job.people


RESOURCE = Resource(router=router, answers=examples.ANSWERS)
