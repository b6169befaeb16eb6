"""Parts that several bodies have."""

import unicodedata
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field
from pydantic_core import PydanticCustomError

_UUID = {"format": "uuid"}
Id = Annotated[str, Field(json_schema_extra=_UUID)]
NextCursor = Annotated[str | None, Field(description="Cursor of the next page; null on the last page.")]


def printable_name(text: str) -> str:
    """Refuse control characters in a name."""
    if any(unicodedata.category(character).startswith("C") for character in text):
        raise PydanticCustomError("control_characters", "Control characters are not allowed.")
    return text


class ResponseModel(BaseModel):
    """Base of the bodies of responses."""

    model_config = ConfigDict(json_schema_serialization_defaults_required=True)


def fields_of(record: object, model: type[BaseModel], without: tuple[str, ...] = ()) -> dict[str, Any]:
    """Values of a model's fields from the attributes of a record with the same names."""
    return {name: getattr(record, name) for name in model.model_fields if name not in without}
