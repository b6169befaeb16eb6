"""Parts that several bodies have."""

import unicodedata
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, GetJsonSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError

from api.web.contract.examples import WARNING
from pipeline.core.findings import Severity
from pipeline.core.problems.code_group import Code
from pipeline.core.problems.request_codes import CONTROL_CHARACTERS

_UUID = {"format": "uuid"}
Id = Annotated[str, Field(json_schema_extra=_UUID)]
SourceUrl = Annotated[
    str,
    Field(
        max_length=4000,
        pattern=r"^https?://[^\s/?#@\\]+([/?][^\s#\\]*)?$",
        examples=["https://store.example/take-3/cam01.mp4?signature=..."],
        description="Public https link that gives the file itself, without a redirect; the service fetches it.",
    ),
]
NextCursor = Annotated[str | None, Field(description="Cursor of the next page; null on the last page.")]


def printable_name(text: str) -> str:
    """Refuse control characters in a name."""
    if any(unicodedata.category(character).startswith("C") for character in text):
        raise PydanticCustomError(CONTROL_CHARACTERS, "Control characters are not allowed.")
    return text


class DescribedModel(BaseModel):
    """Base of all bodies and messages: a long description of a field stands below the field."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        schema = handler(core_schema)
        for field in handler.resolve_ref_schema(schema).get("properties", {}).values():
            if "description" in field:
                field["description"] = " ".join(field["description"].split())
        return schema


class RequestModel(DescribedModel):
    """Base of the bodies of requests. Unknown fields are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class ResponseModel(DescribedModel):
    """Base of the bodies of responses, and of the webhooks, whose schema is the same."""

    model_config = ConfigDict(
        json_schema_serialization_defaults_required=True, json_schema_mode_override="serialization"
    )

    @classmethod
    def from_record(cls, record: object, **computed: Any) -> Self:
        """Build the response from the attributes of a record with the names of the fields, and from computed fields."""
        values = {name: getattr(record, name) for name in cls.model_fields if name not in computed}
        return cls.model_validate(values | computed, from_attributes=True)


class FindingOut(ResponseModel):
    """Finding of a check: what is wrong or odd, how it was measured, and how to mend it."""

    code: Code = Field(examples=["frames_repeated"])
    """Stable code, such as `same_video`; `/help/problems` lists all codes."""
    camera: str | None = Field(default=None, examples=["cam_0"])
    """Name of the camera; null if it is not about one camera."""
    severity: Severity = "warning"
    """`error`: the result will be wrong or empty; `warning`: it may be; `info`: something to know."""
    message: str = Field(description="Sentence for people.", examples=[WARNING])
    hint: str | None = Field(default=None, examples=["Export the video again at a constant frame rate."])
    """Remedy; null if there is nothing to mend."""
    evidence: dict[str, Any] = Field(default_factory=dict, examples=[{"file": "cam_0.mp4", "num_frames": 1}])
    """Measured values by name; `/help/findings` describes it for each code."""


class SpaceOut(ResponseModel):
    """Space on disks that a reconstruction is foreseen to need, if it finds nothing of an earlier job to reuse."""

    store_bytes: int = Field(description="Outputs of stages and result files, which stay in the store.")
    scratch_bytes: int = Field(description="Temporary files of a worker meanwhile, in its folder for them.")
    num_people: int
    """Number of people that was assumed: of keypoints as many as a camera shows at a time, of videos three, and at most
    `people` of the spec."""
