"""Bodies of the people of a job: edits, and who is who after them."""

from typing import Annotated, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field
from pydantic_core import PydanticKnownError

from api.web.contract.schemas import ResponseModel, fields_of
from pipeline.core.options.edits import MAX_EDITS, EditedPerson, PeopleEdit, PersonSpan, apply_edits
from worker.store.model.jobs import JobRecord

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
        description="Each edit is applied to the people whom the edits before it leave. An empty list undoes all."
    )


class FoundPersonOut(ResponseModel):
    """Person whom the reconstruction found, before any edit."""

    id: int = Field(description="Number of the person.")
    start_frame: int = Field(description="First frame.")
    num_frames: int = Field(description="Frames from the first to the last one.")


class PieceOut(ResponseModel):
    """Frames of a person whom the reconstruction found."""

    person: int = Field(description="Number of the person who was found.")
    start_frame: int = Field(description="First frame.")
    stop_frame: int = Field(description="Frame after the last one.")


class EditedPersonOut(ResponseModel):
    """Person after all edits."""

    id: int = Field(description="Number of the person, as in the names of the result files.")
    name: str = Field(description="Name of the person.")
    pieces: tuple[PieceOut, ...] = Field(description=f"Frames of the people who were found. {_NUMBERING}")

    @classmethod
    def of(cls, person: EditedPerson) -> Self:
        """Build the response from a person."""
        pieces = tuple(PieceOut(**fields_of(piece, PieceOut)) for piece in person.pieces)
        return cls(id=person.id, name=person.name or f"person-{person.id}", pieces=pieces)


class PeopleOut(ResponseModel):
    """People of a job: who was found, the edits, and who there is after them."""

    revision: int = Field(description="Number of times that the edits were changed; results name it.")
    num_frames: int = Field(description="Frames of the reconstruction, before any cut.")
    found: tuple[FoundPersonOut, ...] = Field(description="People whom the reconstruction found.")
    edits: tuple[_Edit, ...] = Field(description="Edits in their order.")
    people: tuple[EditedPersonOut, ...] = Field(description="People after all edits.")
    start_frame: int = Field(description=f"First frame that a cut keeps. {_NUMBERING}")
    stop_frame: int = Field(description=f"Frame after the last one that a cut keeps. {_NUMBERING}")

    @classmethod
    def of(cls, job: JobRecord, found: tuple[PersonSpan, ...]) -> Self:
        """Build the response from a job and the people whom it found."""
        num_frames = frames_of(job)
        take = apply_edits(found, job.edits, num_frames)
        frames = take.frames or range(num_frames)
        return cls(
            revision=job.revision,
            num_frames=num_frames,
            found=tuple(FoundPersonOut(**fields_of(person, FoundPersonOut)) for person in found),
            edits=job.edits,
            people=tuple(map(EditedPersonOut.of, take.people)),
            start_frame=frames.start,
            stop_frame=frames.stop,
        )


def frames_of(job: JobRecord) -> int:
    """Frames of a job's reconstruction."""
    return job.num_frames if job.spec.frame_range is None else len(range(*job.spec.frame_range))
