"""Pieces of outputs, one of each person, that edits of other people leave as they are.

The key of a stage's output after edits depends on all edits of the job. A piece is kept with the session under a key of
its own, made of what it is computed from, and is found again after any other edit. Without it the piece is computed,
with the same bytes.
"""

import hashlib
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np

from pipeline.stages.inputs import Context
from pipeline.stages.plan import Task


class Pieces:
    """Pieces that a task finds, and those that it makes.

    Parameters
    ----------
    task, context
        The task at hand, of a stage that follows edits.
    """

    def __init__(self, task: Task, context: Context) -> None:
        self._key, self._context = task.piece_key, context
        self.made: dict[str, Path] = {}

    def key(self, *records: object) -> str:
        """Key of a piece that is computed from records: numbers, texts, arrays, and records of these."""
        digest = hashlib.sha256(self._key.encode())
        for record in records:
            _feed(digest.update, record)
        return digest.hexdigest()

    def find(self, key: str) -> bytes | None:
        """Piece that an earlier task has kept under a key; ``None`` if there is none."""
        return self._context.piece(key)

    def keep(self, key: str, path: Path) -> None:
        """Keep a file, which stays until the end of the task, under a key."""
        self.made[key] = path


def _feed(update: Callable[[bytes], None], value: object) -> None:
    """Feed a value to a digest, with its type and shape, so that different values never look alike."""
    if isinstance(value, np.ndarray):
        update(f"array {value.dtype.str} {value.shape} ".encode())
        update(np.ascontiguousarray(value).tobytes())
    elif is_dataclass(value):
        of_record = [getattr(value, field.name) for field in fields(value)]
        update(f"record {len(of_record)} ".encode())
        for one in of_record:
            _feed(update, one)
    elif isinstance(value, tuple):
        update(f"tuple {len(value)} ".encode())
        for one in value:
            _feed(update, one)
    else:
        text = repr(value)
        update(f"{type(value).__name__} {len(text)} {text} ".encode())
