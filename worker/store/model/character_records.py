"""Characters of the user's own, onto which motion is retargeted."""

import hashlib
import json
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
    facts: Mapping[str, Any]  # Format, size, numbers of bones and vertices; see ``check_character``


@dataclass(frozen=True, slots=True)
class Character(CharacterSummary):
    """A character with its bones."""

    bones: Mapping[str, Any]  # Bones as they were recognised, and the skeleton; see ``check_character``
    corrections: Mapping[str, str | None]  # Bones by joint that a user stated; ``None``: the joint has no bone


@dataclass(frozen=True, slots=True)
class JobCharacter:
    """Character that a job moves: a copy of its file, and its corrections, as they were when the job was created."""

    character_id: str  # The character may be changed or deleted since
    file: StoredCharacterFile
    corrections: Mapping[str, str | None]

    @property
    def digest(self) -> str:
        """Digest of all on which files of the character depend."""
        content = json.dumps([self.file.name, self.file.sha256, dict(self.corrections)], sort_keys=True)
        return hashlib.sha256(content.encode()).hexdigest()
