"""A character as a user states it: a file, and a table of bones that corrects what is recognised."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from pipeline.core.runtime.packages.storage import sha256_of
from pipeline.export.character.figure import CharacterFigure, measure
from pipeline.export.character.file_reader import read_character_file
from pipeline.export.character.mapping import map_bones


@dataclass(frozen=True, slots=True)
class CharacterSource:
    """File of a character, GLB, VRM or FBX, with a table of its bones.

    >>> character = CharacterSource(Path("robot.vrm"))  # doctest: +SKIP
    >>> character.open().mapping.document()["missing"]  # doctest: +SKIP
    ['LeftToeBase', 'RightToeBase']
    """

    path: Path
    # Bones by joint that go before those that are recognised, ``None`` for a joint without a bone; see
    # ``pipeline.export.character.mapping.bone_table``
    table: Mapping[str, str | None] = field(default_factory=dict)

    def open(self) -> CharacterFigure:
        """Read the character and recognise its bones.

        Raises
        ------
        InputError
            If the file can't be used, bones are missing, or the table names others than the character has.
        """
        file = read_character_file(self.path)
        return measure(file, map_bones(file, self.table))

    @property
    def sha256(self) -> str:
        """Digest of the file and the table, in hexadecimal; ``OSError`` if the file can't be read."""
        table = json.dumps(dict(self.table), sort_keys=True)
        return hashlib.sha256(f"{sha256_of(self.path)} {table}".encode()).hexdigest()
