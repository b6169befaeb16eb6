"""Edits of a session's people: who is who, put right by hand, for all runs of the session."""

from functools import partial
from typing import Annotated, Self
from uuid import UUID

from fastapi import APIRouter, Query, Response
from pydantic import BeforeValidator, ConfigDict, Field
from pydantic_core import PydanticKnownError

from api.web.auth import RecordsDep
from api.web.contract.description import Resource, problems
from api.web.contract.schemas import ID, DescribedModel, Id, ResponseModel
from api.web.dependencies import ServicesDep, SessionId
from api.web.errors import ApiError, ErrorItem, unprocessable
from api.web.http.bodies.reading import SmallBodyRoute
from api.web.http.conditional import ETAG, NOT_MODIFIED, IfMatch, IfNoneMatch, conditional_by, entity_tag, require_tag
from pipeline.core.errors import InputError
from pipeline.core.options.edited_take import EditedPerson, apply_edits, place_edits, require_places
from pipeline.core.options.edits import MAX_EDITS, PeopleEdit, PersonSpan, Sex
from pipeline.core.problems.request_codes import CONFLICT
from worker.run import tracing
from worker.run.planning import plan_remake
from worker.store.errors import NotFound
from worker.store.model.job_records import JobRecord
from worker.store.model.session_records import SessionEdits
from worker.store.tenant_records import TenantRecords

_Edit = Annotated[PeopleEdit, Field(discriminator="action")]
_NUMBERING = "They are numbered as in the whole session."


def _not_too_long(edits: object) -> object:
    """Refuse a list that is too long before its items are looked at: errors of thousands take a tenth of a second."""
    if isinstance(edits, list) and len(edits) > MAX_EDITS:
        length = {"field_type": "Tuple", "max_length": MAX_EDITS, "actual_length": len(edits)}
        raise PydanticKnownError("too_long", length)
    return edits


class NewEdits(DescribedModel):
    """Edits of a session's people: all of them, in their order. To undo an edit, send the list without it.

    An edit names a person by a place in the world at a frame of the session. With `job_id` it may have a number
    instead: the number that the run of this job gives after the earlier edits.
    """

    model_config = ConfigDict(extra="forbid")

    edits: Annotated[tuple[_Edit, ...], Field(max_length=MAX_EDITS), BeforeValidator(_not_too_long)] = Field(
        description="Each edit is applied to the people that the earlier edits leave. An empty list undoes all.",
        examples=[[{"action": "merge", "person": 1, "other": 3}, {"action": "rename", "person": 1, "name": "Anna"}]],
    )
    job_id: UUID | None = Field(default=None, examples=[ID])
    """Job of the session whose files are made again with these edits, without detecting joints again. Numbers of people
    are this run's. The files of other jobs follow by `POST /v1/jobs/{id}/files`."""


class FoundPersonOut(ResponseModel):
    """Person of a run, before any edit."""

    id: int = Field(description="Number of the person.")
    start_frame: int = Field(description=f"First frame. {_NUMBERING}", examples=[0])
    num_frames: int = Field(description="Frames from the first to the last one.", examples=[300])


class PieceOut(ResponseModel):
    """Frames of a person of a run, before any edit."""

    person: int = Field(description="Number of the person.")
    start_frame: int = Field(description=f"First frame. {_NUMBERING}", examples=[0])
    stop_frame: int = Field(description="Frame after the last one.", examples=[300])


class EditedPersonOut(ResponseModel):
    """Person of a run after all edits."""

    id: int = Field(description="Number of the person, as in the names of the result files.")
    name: str = Field(description="Name of the person.", examples=["Anna"])
    pieces: tuple[PieceOut, ...] = Field(description="Frames of the people before any edit.")
    sex: Sex | None = Field(default=None, description="Sex that was stated; null: as the choices of the job.")
    mass_kg: float | None = Field(default=None, description="Mass that was stated; null: as the choices of the job.")

    @classmethod
    def from_person(cls, person: EditedPerson, first_frame: int) -> Self:
        """Build the response from a person."""
        pieces = tuple(
            PieceOut(
                person=piece.person,
                start_frame=first_frame + piece.start_frame,
                stop_frame=first_frame + piece.stop_frame,
            )
            for piece in person.pieces
        )
        stated = person.described
        sex, mass_kg = (None, None) if stated is None else (stated.sex, stated.mass_kg)
        name = person.name or f"person-{person.id}"
        return cls(id=person.id, name=name, pieces=pieces, sex=sex, mass_kg=mass_kg)


class EditProblemOut(ResponseModel):
    """Reason why an edit is not applied."""

    message: str = Field(description="Sentence for a person.")
    hint: str | None = Field(description="Advice to the caller.")


class OutcomeOut(ResponseModel):
    """Outcome of an edit in a run."""

    person: int | None = Field(description="Number of `person` after all edits; null if there is none any more.")
    other: int | None = Field(description="Number of `other` after all edits; null if there is none any more.")
    problem: EditProblemOut | None = Field(description="Reason why it is not applied; null if it is.")


class RunEditsOut(ResponseModel):
    """Edits in the run of a job: who was found, who there is after the edits, which edits are not applied."""

    job_id: Id
    first_frame: int = Field(description="First frame of the run in the session's numbering.", examples=[0])
    num_frames: int = Field(description="Frames of the run, before any cut.", examples=[300])
    found: tuple[FoundPersonOut, ...] = Field(description="People before any edit.")
    people: tuple[EditedPersonOut, ...] = Field(description="People after all edits.")
    start_frame: int = Field(description=f"First frame that a cut keeps. {_NUMBERING}", examples=[0])
    stop_frame: int = Field(description=f"Frame after the last one that a cut keeps. {_NUMBERING}", examples=[300])
    outcomes: tuple[OutcomeOut, ...] = Field(description="Outcome of each edit; none if the run leaves the edits out.")

    @classmethod
    def from_run(cls, job: JobRecord, found: tuple[PersonSpan, ...], edits: tuple[PeopleEdit, ...]) -> Self:
        """Build the response from a job, the people that it found, and the edits of its session."""
        frames = _frames(job)
        take = apply_edits(found, edits if job.spec.apply_edits else (), frames)
        kept = take.frames or range(len(frames))
        first = frames.start
        return cls(
            job_id=job.id,
            first_frame=first,
            num_frames=len(frames),
            found=tuple(
                FoundPersonOut(id=person.id, start_frame=first + person.start_frame, num_frames=person.num_frames)
                for person in found
            ),
            people=tuple(EditedPersonOut.from_person(person, first) for person in take.people),
            start_frame=first + kept.start,
            stop_frame=first + kept.stop,
            outcomes=tuple(map(OutcomeOut.from_record, take.outcomes)),
        )


class EditsOut(ResponseModel):
    """Edits of a session's people, for all runs of the session."""

    revision: int = Field(description="Number of times that the list was changed; jobs name it as `edits_revision`.")
    edits: tuple[_Edit, ...] = Field(
        description="Edits in their order.",
        examples=[[{"action": "rename", "person": {"frame": 12, "place_m": [0.5, 1.0, 0.9]}, "name": "Anna"}]],
    )
    run: RunEditsOut | None = Field(description="The edits in the run of `job_id`; null without it.")


router = APIRouter(prefix="/v1/sessions", tags=["sessions"], route_class=SmallBodyRoute)


@router.get(
    "/{session_id}/edits",
    summary="Read the edits of a session's people",
    response_model=EditsOut,
    responses={200: {"headers": ETAG}, **NOT_MODIFIED, **problems(404, 409, 422)},
)
def get_session_edits(
    session_id: SessionId,
    records: RecordsDep,
    job_id: Annotated[UUID | None, Query(description="Job of the session, to see the edits in its run.")] = None,
    if_none_match: IfNoneMatch = None,
) -> Response:
    """Read the edits, and who there is after them in a run. The entity tag changes with the edits."""
    records.sessions.get(session_id)
    job = _run(records, session_id, job_id)
    edits = records.edits.get(session_id)
    return conditional_by(_tag(session_id, edits), lambda: _edits_out(records, edits, job), if_none_match)


@router.put(
    "/{session_id}/edits",
    summary="Edit a session's people",
    response_model=EditsOut,
    responses={200: {"headers": ETAG}, **problems(400, 404, 409, 412, 413, 415, 422, 429, 507)},
)
def edit_session(
    session_id: SessionId, new: NewEdits, services: ServicesDep, records: RecordsDep, if_match: IfMatch = None
) -> Response:
    """Replace the edits of a session's people. Later jobs of the session apply them.

    With `If-Match`, only if the edits have not changed since. An edit that names a person by number, and can't be made,
    refuses the whole list. An edit that does not apply to a run stays, and the run's `outcomes` say why. With `job_id`,
    the files of that job are made again. The edits may be changed again meanwhile: work for an earlier list is given
    up. The files of the job's last finished revision can be read until then; its `results_revision` names it.
    """
    session = records.sessions.get(session_id)
    job = _run(records, session_id, new.job_id)
    revision = None
    if if_match is not None:
        before = records.edits.get(session_id)
        require_tag(_tag(session_id, before), if_match)
        revision = before.revision
    placed = _placed(records, new, job)
    if job is None:
        edits = records.edits.replace(session_id, placed, revision)
    else:
        services.disk.require_room()
        with records.transaction() as work:
            plan = partial(plan_remake, session)
            work.jobs.remake(job.id, plan, edits=placed, edits_revision=revision, trace=tracing.current())
            edits = work.edits.get(session_id)
        services.queue.publish()
    return conditional_by(_tag(session_id, edits), lambda: _edits_out(records, edits, job), None)


def _placed(records: TenantRecords, new: NewEdits, job: JobRecord | None) -> tuple[PeopleEdit, ...]:
    """Edits that name people by places; ``ApiError`` with the place of an edit that can't be made."""
    people, frames = ((), range(0)) if job is None else (records.edits.people(job.id), _frames(job))
    try:
        if job is None:
            require_places(new.edits)
        return place_edits(people, new.edits, frames)
    except InputError as error:
        raise unprocessable(
            [
                ErrorItem(code=problem.code, message=problem.message, pointer=f"/{problem.field}", hint=problem.hint)
                for problem in error.problems
            ]
        ) from error


def _run(records: TenantRecords, session_id: str, job_id: UUID | None) -> JobRecord | None:
    """Job of a session that has people; ``None`` without an id."""
    if job_id is None:
        return None
    job = records.jobs.get(str(job_id))
    if job.session_id != session_id:
        raise NotFound("The capture has no such job.")
    if not job.has_people:
        raise ApiError(CONFLICT, "The job has no people yet.", hint="Wait until the job has succeeded.")
    return job


def _frames(job: JobRecord) -> range:
    """Frames of a job's run, in the session's numbering."""
    return range(job.num_frames) if job.spec.frame_range is None else range(*job.spec.frame_range)


def _tag(session_id: str, edits: SessionEdits) -> str:
    """Entity tag of a session's edits; they are not applied for it."""
    return entity_tag(session_id, edits.revision)


def _edits_out(records: TenantRecords, edits: SessionEdits, job: JobRecord | None) -> EditsOut:
    run = None if job is None else RunEditsOut.from_run(job, records.edits.people(job.id), edits.edits)
    return EditsOut(revision=edits.revision, edits=edits.edits, run=run)


RESOURCE = Resource(router=router)
