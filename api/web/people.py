"""People of a job: who was found, and the edits that put them right."""

from typing import Annotated, Self

from fastapi import APIRouter, Response, status
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field
from pydantic_core import PydanticKnownError

from api.web.auth import RecordsDep
from api.web.contract.description import RETRY_AFTER, Resource, Responses, location, problems
from api.web.contract.schemas import ResponseModel
from api.web.dependencies import POLL_AFTER_S, JobId, ServicesDep
from api.web.errors import ApiError, ErrorItem, unprocessable
from api.web.http.bodies.reading import SmallBodyRoute
from api.web.http.conditional import ETAG, NOT_MODIFIED, IfMatch, IfNoneMatch, conditional_by, entity_tag, require_tag
from api.web.jobs.schemas import JobOut
from pipeline.core.errors import InputError
from pipeline.core.options.edited_take import EditedPerson, apply_edits, place_edits
from pipeline.core.options.edits import MAX_EDITS, PeopleEdit, PersonSpan
from pipeline.core.problems.request_codes import CONFLICT
from worker.run import tracing
from worker.run.planning import plan_job
from worker.store.model.job_records import JobRecord

_Edit = Annotated[PeopleEdit, Field(discriminator="action")]
_NUMBERING = "They are numbered as before any cut."


def _not_too_long(edits: object) -> object:
    """Refuse a list that is too long before its items are looked at: errors of thousands take a tenth of a second."""
    if isinstance(edits, list) and len(edits) > MAX_EDITS:
        length = {"field_type": "Tuple", "max_length": MAX_EDITS, "actual_length": len(edits)}
        raise PydanticKnownError("too_long", length)
    return edits


class PeopleEdits(BaseModel):
    """Edits of a job's people: all of them, in their order. To undo an edit, send the list without it."""

    model_config = ConfigDict(extra="forbid")

    edits: Annotated[tuple[_Edit, ...], Field(max_length=MAX_EDITS), BeforeValidator(_not_too_long)] = Field(
        description="Each edit is applied to the people that the earlier edits leave. An empty list undoes all.",
        examples=[[{"action": "merge", "person": 1, "other": 3}, {"action": "rename", "person": 1, "name": "Anna"}]],
    )


class FoundPersonOut(ResponseModel):
    """Person of the reconstruction, before any edit."""

    id: int = Field(description="Number of the person.")
    start_frame: int = Field(description="First frame.", examples=[0])
    num_frames: int = Field(description="Frames from the first to the last one.", examples=[300])


class PieceOut(ResponseModel):
    """Frames of a person of the reconstruction."""

    person: int = Field(description="Number of the person who was found.")
    start_frame: int = Field(description="First frame.", examples=[0])
    stop_frame: int = Field(description="Frame after the last one.", examples=[300])


class EditedPersonOut(ResponseModel):
    """Person after all edits."""

    id: int = Field(description="Number of the person, as in the names of the result files.")
    name: str = Field(description="Name of the person.", examples=["Anna"])
    pieces: tuple[PieceOut, ...] = Field(description=f"Frames of the people who were found. {_NUMBERING}")

    @classmethod
    def from_person(cls, person: EditedPerson) -> Self:
        """Build the response from a person."""
        return cls.from_record(person, name=person.name or f"person-{person.id}")


class PeopleOut(ResponseModel):
    """People of a job: who was found, the edits, and who there is after them."""

    revision: int = Field(description="Number of times that the edits were changed; results name it.")
    num_frames: int = Field(description="Frames of the reconstruction, before any cut.", examples=[300])
    found: tuple[FoundPersonOut, ...] = Field(description="People of the reconstruction.")
    edits: tuple[_Edit, ...] = Field(
        description="Edits in their order.", examples=[[{"action": "rename", "person": 1, "name": "Anna"}]]
    )
    people: tuple[EditedPersonOut, ...] = Field(description="People after all edits.")
    start_frame: int = Field(description=f"First frame that a cut keeps. {_NUMBERING}", examples=[0])
    stop_frame: int = Field(description=f"Frame after the last one that a cut keeps. {_NUMBERING}", examples=[300])

    @classmethod
    def from_job(cls, job: JobRecord, found: tuple[PersonSpan, ...]) -> Self:
        """Build the response from a job and the people that it found."""
        num_frames = motion_frames(job)
        take = apply_edits(found, job.edits, range(num_frames))
        frames = take.frames or range(num_frames)
        return cls.from_record(
            job,
            num_frames=num_frames,
            found=found,
            people=tuple(map(EditedPersonOut.from_person, take.people)),
            start_frame=frames.start,
            stop_frame=frames.stop,
        )


def motion_frames(job: JobRecord) -> int:
    """Frames of a job's reconstruction."""
    return job.num_frames if job.spec.frame_range is None else len(range(*job.spec.frame_range))


router = APIRouter(prefix="/v1/jobs", tags=["jobs"], route_class=SmallBodyRoute)

_ACCEPTED: Responses = {
    202: {"headers": {"Location": location("job"), **RETRY_AFTER}},
}


@router.get(
    "/{job_id}/people",
    operation_id="getJobPeople",
    summary="Read a job's people",
    response_model=PeopleOut,
    responses={200: {"headers": ETAG}, **NOT_MODIFIED, **problems(404, 409)},
)
def get_job_people(job_id: JobId, records: RecordsDep, if_none_match: IfNoneMatch = None) -> Response:
    """Read who was found, the edits, and who there is after them. The entity tag changes with the edits."""
    job = records.jobs.get(job_id)
    found = _found(job)
    return conditional_by(_tag(job), lambda: PeopleOut.from_job(job, found), if_none_match)


@router.put(
    "/{job_id}/people",
    operation_id="editJobPeople",
    summary="Edit a job's people",
    status_code=status.HTTP_202_ACCEPTED,
    response_model=JobOut,
    responses={**_ACCEPTED, **problems(400, 404, 409, 412, 413, 415, 422, 429, 507)},
)
def edit_job_people(
    job_id: JobId,
    edits: PeopleEdits,
    services: ServicesDep,
    records: RecordsDep,
    if_match: IfMatch = None,
) -> Response:
    """Replace the edits of a job's people; the files are written again, without detecting joints again.

    With `If-Match`, only if the edits have not changed since. The edits may be changed again before their files are
    made: work for an earlier list is given up. The files of the last finished revision can be read until then. The
    job's `results_revision` names it.
    """
    job = records.jobs.get(job_id)
    found = _found(job)
    if if_match is not None:
        require_tag(_tag(job), if_match)
    try:
        place_edits(found, edits.edits, range(motion_frames(job)))
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
        JobOut.from_job(edited).model_dump_json(),
        status_code=status.HTTP_202_ACCEPTED,
        headers={"Location": f"/v1/jobs/{job_id}", "Retry-After": str(POLL_AFTER_S)},
        media_type="application/json",
    )


def _tag(job: JobRecord) -> str:
    """Entity tag of a job's people; the edits are not applied for it."""
    return entity_tag(job.revision, job.edits, job.people, motion_frames(job))


def _found(job: JobRecord) -> tuple[PersonSpan, ...]:
    if job.people is None:
        raise ApiError(
            CONFLICT,
            "The job has no people yet.",
            hint="Wait until the job has succeeded. Reconstruct the capture again if an older version did it.",
        )
    return job.people


RESOURCE = Resource(router=router)
