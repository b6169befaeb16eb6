"""Parts that several bodies have, and examples that derive from schemas and from examples of single fields."""

import unicodedata
from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, GetJsonSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError

from pipeline.core.findings import Severity
from pipeline.core.problems.code_group import Code
from pipeline.core.problems.request_codes import CONTROL_CHARACTERS

ID = "01890a5e-1f3b-7d52-9c41-5a6f0b1c2d3e"
UPLOAD_IDS = [f"01890a5c-7c1e-7a4b-8f00-00000000000{index}" for index in range(2)]
TIME = "2026-03-01T09:30:00Z"
SHA256 = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"

WARNING = "cam_0.mp4: 1 frame is left out, because another frame has the same timestamp."

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


_TEXTS = {"uuid": ID, "date-time": TIME, "binary": "(the file)"}


def derive_example(schema: Mapping[str, Any], models: Mapping[str, Any]) -> Any:
    """Derive an example from a JSON schema.

    An example of the schema goes before its default, and null before other types. Objects have their required fields,
    and optional fields that have an example.

    ``models``: schemas that references name.
    """
    match schema:
        case {"examples": [given, *_]} | {"default": given} | {"const": given} | {"enum": [given, *_]}:
            example = given
        case {"$ref": str(reference)}:
            example = derive_example(models[reference.rpartition("/")[2]], models)
        case {"anyOf": [first, *others]} | {"oneOf": [first, *others]}:
            example = None if {"type": "null"} in others else derive_example(first, models)
        case {"type": "object"}:
            required, fields = schema.get("required", ()), schema.get("properties", {}).items()
            shown = {name: field for name, field in fields if name in required or "examples" in field}
            example = {name: derive_example(field, models) for name, field in shown.items()}
        case {"prefixItems": [*items]}:
            example = [derive_example(item, models) for item in items]
        case {"type": "array"}:
            example = [derive_example(schema["items"], models)] * schema.get("minItems", 1)
        case {"type": "string"}:
            example = _TEXTS.get(schema.get("format", ""), "...")
        case {"type": "boolean"}:
            example = False
        case _:
            example = max(1, schema.get("minimum", 1))
    return example
