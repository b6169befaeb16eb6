"""Errors of characters' files."""

import contextlib
from collections.abc import Iterator

from pipeline.core.errors import InputError, Problem
from pipeline.core.problems.model import Code
from pipeline.core.problems.sessions import CHARACTER_UNREADABLE

MAX_NODES = 20_000
"""Largest number of nodes of a file."""
MAX_LEVELS = 512
"""Largest number of levels of nodes."""
MAX_COORDINATE = 1e9
"""Largest coordinate: larger ones are damage, and products of a few of them don't overflow."""
MAX_SCALE, MIN_SCALE = 1e6, 1e-9
"""Scales between which nodes are."""

_EXPORT_AGAIN = "Export the character once more, as GLB (binary glTF 2.0) with everything inside."


class CharacterFileError(Exception):
    """A file can't be used: code, message and hint."""

    def __init__(self, message: str, code: Code = CHARACTER_UNREADABLE, hint: str = _EXPORT_AGAIN) -> None:
        super().__init__(message)
        self.code, self.message, self.hint = code, message, hint


@contextlib.contextmanager
def checked(name: str) -> Iterator[None]:
    """Block in which errors of a file become an ``InputError`` with the file's name."""
    try:
        yield
    except CharacterFileError as error:
        raise InputError([Problem(error.code, error.message, file=name, hint=error.hint)]) from error
