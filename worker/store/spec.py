"""Job specs: the choices of a reconstruction, made from ``options.config`` and checked by ``options.rules``."""

from typing import TYPE_CHECKING, Annotated, Any, Literal
from uuid import UUID

from pydantic import BaseModel, ConfigDict, Field, PlainValidator, ValidationError, WithJsonSchema, create_model
from pydantic_core import InitErrorDetails, PydanticCustomError

from pipeline.core.options.choices import Choice
from pipeline.core.options.config import CHOICES, JobChoices, ReconstructionConfig
from pipeline.core.options.rules import plain_value, value_faults

Priority = Literal["preview", "normal", "batch"]


def _field(choice: Choice) -> tuple[Any, Any]:
    def check(value: Any) -> Any:
        found = value_faults(choice, value)
        if found:
            errors: list[InitErrorDetails] = [
                {"type": PydanticCustomError(problem.code, problem.message), "loc": steps, "input": value}
                for steps, problem in found
            ]
            raise ValidationError.from_exception_data(choice.name, errors)
        return plain_value(choice, value)

    field = Field(default=choice.default, description=choice.description)
    return Annotated[Any, PlainValidator(check), WithJsonSchema(dict(choice.schema))], field


if TYPE_CHECKING:

    class _Choices(JobChoices, BaseModel, frozen=True):
        """Fields as type checkers see them; at run time ``pipeline.core.options.rules`` checks their values."""
else:
    _Choices = create_model("_Choices", **{name: _field(choice) for name, choice in CHOICES.items()})


_CHARACTER = (
    "Stored character that moves as each person, in files of its own. The job keeps a copy of it, with the bones that "
    "it has now."
)


class JobSpec(_Choices, frozen=True):
    """A reconstruction's choices. Unknown fields are refused."""

    model_config = ConfigDict(extra="forbid")

    character: UUID | None = Field(
        default=None,
        examples=[None],
        description=_CHARACTER,
    )
    apply_edits: bool = Field(
        default=True,
        strict=True,
        description="Apply the edits of the capture's people. False: leave them out.",
    )
    priority: Priority = Field(
        default="normal",
        description="Order among the jobs of one tenant: edits of people are first, then "
        "chunks of `preview`, of `normal` and of `batch`. Shares of other tenants stay the same.",
    )
    keep_videos: bool = Field(
        default=True,
        strict=True,
        description="False: once the job has succeeded and no job of the session is at work, the session's videos are "
        "deleted, with all pictures of them but those in result files. Results stay.",
    )
    callback_url: str | None = Field(
        default=None,
        max_length=2000,
        pattern=r"^https?://[^\s/?#@\\]+([/?][^\s#\\]*)?$",
        examples=["https://portal.example/hooks/multicap"],
        description="Told of the job's end by a Standard Webhook: `job.succeeded`, `.failed`, `.canceled`, `.expired`.",
    )

    @property
    def config(self) -> ReconstructionConfig:
        """Configuration of the reconstruction."""
        choices = {name: getattr(self, name) for name in CHOICES}
        return ReconstructionConfig(**choices, blurs_videos=self.blur_faces)


_FILE_CHOICES = ("preset", "timeline", "body", "output_rate_hz")
_ADDED = ("report", "overlay", "blur_faces")

if TYPE_CHECKING:

    class _FileChoices(JobChoices, BaseModel, frozen=True):
        """Fields as type checkers see them."""
else:
    _names = ("exports", *_FILE_CHOICES, *_ADDED)
    _FileChoices = create_model("_FileChoices", **{name: _field(CHOICES[name]) for name in _names})


class FilesAdded(_FileChoices, frozen=True):
    """Files that a finished job gets, besides the files that it has: only the fields that are sent count.

    `exports`, `report`, `overlay` and `blur_faces` add to the job's spec. The other fields replace the job's, for all
    of its files.
    """

    model_config = ConfigDict(extra="forbid")

    character: UUID | None = Field(default=None, examples=[None], description=_CHARACTER)
    apply_edits: bool = Field(default=True, strict=True, description="As in the spec of a job.")

    def added_to(self, spec: JobSpec) -> JobSpec:
        """Spec of the job with these files."""
        sent = self.model_fields_set
        changed = {name: getattr(self, name) for name in (*_FILE_CHOICES, "apply_edits", "character") if name in sent}
        changed |= {name: getattr(spec, name) or getattr(self, name) for name in _ADDED}
        exports = (*spec.exports, *(self.exports if "exports" in sent else ()))
        return spec.model_copy(update={**changed, "exports": tuple(dict.fromkeys(exports))})
