"""Bodies of requests for characters, and of their responses, as Pydantic models."""

from typing import Annotated, Any, Literal, Self
from uuid import UUID

from pydantic import AfterValidator, AwareDatetime, Field

from api.web.contract.schemas import ID, SHA256, FindingOut, Id, NextCursor, RequestModel, ResponseModel, printable_name
from api.web.http.bodies.form_kinds import CHARACTER, UploadedFiles
from worker.store.model.character_records import Character, CharacterSummary

Method = Literal["vrm", "names", "shape", "table"]
_METHODS = (
    "`vrm`: by the table of a VRM; `names`: by names; `shape`: by the shape of the tree; `table`: by corrections, and "
    "the others in one of these ways."
)
_Name = Annotated[str, AfterValidator(printable_name), Field(min_length=1, max_length=200)]
Corrections = Annotated[
    dict[
        Annotated[str, Field(min_length=1, max_length=50)], Annotated[str, Field(min_length=1, max_length=250)] | None
    ],
    Field(max_length=100),
]


class CharacterSpec(RequestModel):
    """Choices of a character beside its file. Unknown fields are refused."""

    name: _Name | None = Field(default=None, description="Name for people; by default the name of the file.")
    bones: Corrections = Field(default={}, examples=[{"LeftArm": "upperarm_l", "LeftShoulder": None}])
    """Bones by joint that go before those that are recognised; null: the joint has no bone. Others are recognised."""


class UploadedCharacter(UploadedFiles, CharacterSpec):
    """Character of an uploaded file, given by the id of its upload. Unknown fields are refused."""

    character: UUID = Field(description="Upload of the character's file.")

    def uploads(self) -> list[tuple[str, UUID | str]]:
        """Part of the form and id of each upload."""
        return [(CHARACTER, self.character)]


class CharacterChanges(RequestModel):
    """Changes of a character; what is left out stays. Unknown fields are refused."""

    name: _Name | None = Field(default=None, description="Name of the character for people.", examples=["Robot, March"])
    bones: Corrections | None = None
    """Corrections in place of earlier ones: bones by joint, null for a joint that has no bone. An empty object takes
    all corrections back."""


class CharacterUrls(ResponseModel):
    """Paths of a character and of its file."""

    self: str = Field(description="Path of the character.", examples=[f"/v1/characters/{ID}"])
    file: str = Field(description="Path of the file.", examples=[f"/v1/characters/{ID}/file"])


class CharacterSummaryOut(ResponseModel):
    """Character of the user's own, without its bones."""

    id: Id
    name: str = Field(description="Name of the character for people.", examples=["Robot"])
    created_at: AwareDatetime = Field(description="Time of the creation.")
    file: str = Field(description="Name of the file.", examples=["robot.vrm"])
    num_bytes: int = Field(description="Size of the file.", examples=[5_242_880])
    sha256: str = Field(description="SHA-256 of the file.", examples=[SHA256])
    format: Literal["GLB", "VRM 0.x", "VRM 1.0", "FBX"] = Field(description="Format of the file.", examples=["VRM 1.0"])
    method: Method = Field(description=f"How the bones were recognised. {_METHODS}")
    stature: float = Field(examples=[1.72])
    """Height of the mesh in the rest pose, in the file's unit: metres by the rules of glTF; FBX is converted to
    metres."""
    num_bones: int = Field(description="Number of bones.", examples=[54])
    num_vertices: int = Field(examples=[12_480])
    """Number of vertices that bones move; those in compressed form don't count."""
    urls: CharacterUrls

    @classmethod
    def from_character(cls, character: CharacterSummary, **more: Any) -> Self:
        """Build the response from a character; ``more`` are the fields of its bones."""
        address, file = f"/v1/characters/{character.id}", character.file
        urls = CharacterUrls(self=address, file=f"{address}/file")
        return cls(
            id=character.id,
            name=character.name,
            created_at=character.created_at,
            file=file.name,
            num_bytes=file.num_bytes,
            sha256=file.sha256,
            urls=urls,
            **character.facts,
            **more,
        )


class JointOut(ResponseModel):
    """Joint of Multicap's skeleton, and the bone of the character that moves with it."""

    joint: str = Field(description="Name of the joint.", examples=["LeftArm"])
    bone: str | None = Field(description="Name of the bone; null: the joint has none.", examples=["upperarm_l"])
    recognised_by: Method | None = Field(examples=["vrm"])
    """How the bone was recognised; `table`: it was stated."""
    is_required: bool = Field(description="Whether each character must have the bone.", examples=[True])


class BoneOut(ResponseModel):
    """Bone of a character in the rest pose."""

    bone: str = Field(description="Name of the bone.", examples=["upperarm_l"])
    parent: str | None = Field(description="Name of the next bone above; null at the top.", examples=["spine"])
    position: tuple[float, float, float] = Field(examples=[[0.18, 0.02, 1.4]])
    """Position of the bone's joint, in the unit of the stature, Z up; the character faces -Y."""


class CharacterOut(CharacterSummaryOut):
    """Character of the user's own, with its bones."""

    joints: tuple[JointOut, ...] = Field(description="All joints, with and without bones.")
    spine: tuple[str, ...] = Field(description="Bones between hips and arms, from below.", examples=[["spine"]])
    neck: tuple[str, ...] = Field(description="Bones between arms and head, from below.", examples=[["neck"]])
    twists: dict[str, str] = Field(description="Bones that share the twist of a limb, with the joint at its end.")
    at_rest: tuple[str, ...] = Field(examples=[["tail"]])
    """Bones without a counterpart, which stay at rest."""
    warnings: tuple[FindingOut, ...]
    """Warnings about hands and feet that hang elsewhere than on their limbs."""
    skeleton: tuple[BoneOut, ...] = Field(description="All bones, parents before their children.")
    corrections: dict[str, str | None] = Field(examples=[{"LeftArm": "upperarm_l"}])
    """Bones by joint that were stated; null: no bone."""

    @classmethod
    def from_bones(cls, character: Character) -> Self:
        """Build the response from a character with its bones."""
        return cls.from_character(character, **character.bones, corrections=dict(character.corrections))


class CharacterPage(ResponseModel):
    """Page of characters, the newest character first."""

    characters: tuple[CharacterSummaryOut, ...]
    next_cursor: NextCursor
