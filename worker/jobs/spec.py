"""Job specs: the choices of a reconstruction, made from ``pipeline.config``."""

import functools
import operator
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args, get_origin

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, create_model, field_validator
from pydantic.config import JsonDict
from pydantic_core import PydanticCustomError, PydanticKnownError

from pipeline.choices import About, Choice, OtherNames, Value, members, values_of
from pipeline.config import (
    CHOICES,
    MAX_OUTPUT_FRAMES,
    JobChoices,
    ReconstructionConfig,
    too_long_for,
    unlimited_alternatives,
)


def _number(value: object) -> object:
    # Strict integers would refuse 2.0 too, which is a whole number in JSON.
    if isinstance(value, bool | str):
        raise PydanticKnownError("int_type")
    return value


def _field_type(hint: Any, about: About) -> Any:
    """Pydantic's type of a choice: named values as one enumeration, numbers with their limits, never converted."""
    # Types that are made when the module runs; type checkers see the fields of `_Choices`.
    literal: Any = Literal
    sequence: Any = tuple
    named = tuple(values_of(hint, Value))
    if get_origin(hint) is tuple:
        items = get_args(hint)
        if items[1] is Ellipsis:
            return sequence[literal[named], ...]
        return sequence[tuple(_field_type(item, about) for item in items)]
    limits: Any = {"ge": about.minimum, "gt": about.above, "le": about.maximum}
    others = [member for member in members(hint) if get_origin(member) is not Annotated]
    types: list[Any] = [literal[named]] if named else []
    noted = [get_args(member)[1] for member in members(hint) if get_origin(member) is Annotated]
    types += [Annotated[str, Field(pattern=names.pattern)] for names in noted if isinstance(names, OtherNames)]
    for member in others:
        if member is bool:
            types.append(Annotated[bool, Field(strict=True)])
        elif member is float:
            types.append(Annotated[float, Field(strict=True, allow_inf_nan=False, **limits)])
        elif member is int:
            types.append(Annotated[int, Field(**limits), BeforeValidator(_number)])
        else:
            types.append(member if member is type(None) else _field_type(member, about))
    return functools.reduce(operator.or_, types)


def _field(choice: Choice) -> tuple[Any, Any]:
    """Type and properties of the field of a choice."""
    extra: JsonDict | None = {"uniqueItems": True} if choice.kind == "several" else None
    return _field_type(choice.hint, choice.about), Field(
        default=choice.default, description=choice.description, json_schema_extra=extra
    )


if TYPE_CHECKING:

    class _Choices(JobChoices, BaseModel, frozen=True):
        """Fields as type checkers see them; at run time Pydantic checks their values and limits."""
else:
    _Choices = create_model("_Choices", **{name: _field(choice) for name, choice in CHOICES.items()})


class JobSpec(_Choices, frozen=True):
    """A reconstruction's choices. Unknown fields are refused."""

    model_config = ConfigDict(extra="forbid")

    callback_url: str | None = Field(
        default=None,
        max_length=2000,
        pattern=r"^https?://[^\s/?#@\\]+([/?][^\s#\\]*)?$",
        examples=["https://portal.example/hooks/multicap"],
        description="Told of the job's end by a Standard Webhook: `job.succeeded`, `.failed`, `.canceled`, `.expired`.",
    )

    @field_validator("exports")
    @classmethod
    def _each_once(cls, exports: tuple[str, ...]) -> tuple[str, ...]:
        if len(set(exports)) < len(exports):
            raise PydanticCustomError("export_repeated", "exports must name each format once.")
        return exports

    def problems(self, num_frames: int, frame_rate_hz: float) -> dict[str, tuple[str, str]]:
        """Conflicts of the choices with a session of so many output frames: code and sentence by field."""
        found = {}
        if self.frame_range is not None:
            start, stop = self.frame_range
            if not start < stop <= num_frames:
                message = f"The session has the output frames 0 to {num_frames}; the second number is after the last."
                found["frame_range"] = "frame_range", message
            else:
                num_frames = stop - start
        if self.smoothing == "butterworth" and self.cutoff_hz >= frame_rate_hz / 2:
            message = f"The cutoff must be below half of the session's frame rate, {frame_rate_hz / 2:g} Hz."
            found["cutoff_hz"] = "cutoff_range", message
        if self.output_rate_hz is not None:
            num_frames = round((num_frames - 1) * self.output_rate_hz / frame_rate_hz) + 1
            if num_frames > MAX_OUTPUT_FRAMES:
                message = (
                    f"At this rate the session has {num_frames:,} frames; at most {MAX_OUTPUT_FRAMES:,} are written. "
                    "Ask for a lower rate, or for fewer frames by frame_range."
                )
                found["output_rate_hz"] = "too_many_frames", message
        for export, limit in too_long_for(self.exports, num_frames):
            others = " or ".join(unlimited_alternatives(export))
            message = f"A {export.upper()} file holds {limit} frames at most; these are {num_frames}. Use {others}."
            found["exports"] = f"too_long_for_{export}", message
        return found

    @property
    def config(self) -> ReconstructionConfig:
        """Configuration of the reconstruction."""
        return ReconstructionConfig(**{name: getattr(self, name) for name in CHOICES})
