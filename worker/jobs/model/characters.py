"""Characters of the user's own, onto which motion is retargeted."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any


@dataclass(frozen=True, slots=True)
class StoredCharacterFile:
    """File of a character in the artifact store."""

    name: str  # Name under which the client sent it
    key: str
    num_bytes: int
    sha256: str


@dataclass(frozen=True, slots=True)
class CharacterSummary:
    """A character as lists show it."""

    id: str
    name: str
    created_at: datetime
    file: StoredCharacterFile
    facts: Mapping[str, Any]  # Format, size, numbers of bones and vertices; see ``pipeline.character.check``


@dataclass(frozen=True, slots=True)
class Character(CharacterSummary):
    """A character with its bones."""

    bones: Mapping[str, Any]  # Bones as they were recognised, and the skeleton; see ``pipeline.character.check``
    corrections: Mapping[str, str | None]  # Bones by joint that a user stated; ``None``: the joint has no bone
