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
    """Type and properties of the field of a choice."""

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


class JobSpec(_Choices, frozen=True):
    """A reconstruction's choices. Unknown fields are refused."""

    model_config = ConfigDict(extra="forbid")

    character: UUID | None = Field(
        default=None,
        examples=[None],
        description="Stored character that moves as each person, in files of its own. The job keeps a copy of it, with "
        "the bones that it has now.",
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
