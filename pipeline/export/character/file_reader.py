"""Characters out of files of strangers: the reader is chosen by the file's content."""

from pathlib import Path

from pipeline.core.problems.sessions import CHARACTER_TOO_LARGE
from pipeline.export.character.fbx.content import is_fbx
from pipeline.export.character.fbx.reader import decode_fbx_character
from pipeline.export.character.gltf_reader import CharacterFile, decode_character
from pipeline.export.character.problems import CharacterFileError, checked

MAX_BYTES = 512 << 20
"""Largest file that is read."""


def read_character_file(path: Path) -> CharacterFile:
    """Read a character from a GLB, VRM or FBX file.

    Raises
    ------
    InputError
        If the file can't be read, is in another format, is damaged, is larger than ``MAX_BYTES``, or has more nodes
        and vertices than are read.
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
