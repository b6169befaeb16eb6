"""A character as a user states it: a file, and a table of bones that corrects what is recognised."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from pipeline.core.problems.session_codes import CHARACTER_TOO_LARGE
from pipeline.core.runtime.packages.storage import file_sha256
from pipeline.export.character.fbx.content import is_fbx
from pipeline.export.character.fbx.reader import decode_fbx_character
from pipeline.export.character.figure import CharacterFigure, measure
from pipeline.export.character.gltf_reader import CharacterFile, decode_character
from pipeline.export.character.mapping import map_bones
from pipeline.export.character.rig import CharacterFileError, checked

MAX_BYTES = 512 << 20
"""Largest file that is read."""


def read_character_file(path: Path) -> CharacterFile:
    """Read a character from a GLB, VRM or FBX file.

    Raises ``InputError`` if the file can't be read, is in another format, is damaged, is larger than ``MAX_BYTES``, or
    has more nodes and vertices than are read.
    """
    with checked(path.name):
        try:
            if path.stat().st_size > MAX_BYTES:
                message = f"The file has more than {MAX_BYTES >> 20} MiB."
                raise CharacterFileError(message, CHARACTER_TOO_LARGE, "Leave out what is not the character.")
            content = path.read_bytes()
        except OSError as error:
            message = f"The file can't be read: {error.strerror or error}."
            raise CharacterFileError(message, hint="Check it.") from error
    return (decode_fbx_character if is_fbx(content) else decode_character)(path.name, content)


@dataclass(frozen=True, slots=True)
class CharacterSource:
    """File of a character, GLB, VRM or FBX, with a table of its bones.

    Parameters
    ----------
    path
        File of the character.
    table
        Table of its bones; ``None``: bones are recognised by their names.

    Examples
    --------
    >>> CharacterSource(Path("robot.vrm")).path.suffix
    '.vrm'
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
        return hashlib.sha256(f"{file_sha256(self.path)} {table}".encode()).hexdigest()
