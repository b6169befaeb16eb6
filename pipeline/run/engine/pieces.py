"""Pieces of outputs, of each person or of a take, that edits of other people or names leave as they are.

The key of a stage's output after edits depends on all edits of the job. A piece is kept with the session under a key of
its own, made of what it is computed from, and is found again after any other edit. Without it the piece is computed,
with the same bytes.
"""

import hashlib
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.options.edits import PeopleEdit, edit_document, without_names
from pipeline.core.options.file_formats import FILE_FORMATS, PLUGINS, formats_of_people
from pipeline.export.person_files import KeptFile, KeptFiles, PersonOfTake, replacing, spoilt
from pipeline.export.quality.report import encode as encode_report
from pipeline.export.quality.report import quality_report
from pipeline.export.quality.views import GetViews
from pipeline.export.results import METRICS
from pipeline.export.viewer.description import with_names
from pipeline.export.writers.registry import find_writer
from pipeline.export.writers.rotation_orders import BetweenFrames
from pipeline.run.engine.stage import DESCRIPTION, MOTION, Context, ResultFile, Task
from pipeline.run.engine.take import viewer_files_in

_NOBODY = ""


class Pieces:
    """Pieces that a task finds, and those that it keeps. The task at hand is of a stage that follows edits."""

    def __init__(self, task: Task, context: Context) -> None:
        self._key, self._context = task.piece_key, context
        self.files: dict[str, Path] = {}

    def key(self, *records: object) -> str:
        """Key of a piece that is computed from records: numbers, texts, arrays, and records of these."""
        digest = hashlib.sha256(self._key.encode())
        for record in records:
            _feed(digest.update, record)
        return digest.hexdigest()

    def find(self, key: str) -> bytes | None:
        """Piece that an earlier task has kept under a key; ``None`` if there is none."""
        return self._context.files.piece(key)

    def keep(self, key: str, path: Path) -> None:
        """Keep a file, which stays until the end of the task, under a key."""
        self.files[key] = path


class FilesInPieces(KeptFiles):
    """Files of people that earlier tasks have kept, and those that this task keeps, whoever is renamed.

    A piece is a line of JSON with what was found in a file, and then the file. ``scratch`` is for temporary files
    of the task.
    """

    def __init__(self, pieces: Pieces, scratch: Path) -> None:
        self._pieces, self._scratch = pieces, scratch
        self._digested: tuple[PersonOfTake, str] | None = None  # the last person, with a digest of all but the name

    def find(self, person: PersonOfTake, name: str, path: Path) -> KeptFile | None:
        """Write a person's file, if it is kept, and read it back."""
        piece = self._pieces.find(self._key(person, name))
        if piece is None:
            return None
        head, _, content = piece.partition(b"\n")
        with replacing(path, [content]) as part:
            if part.read_bytes() != content:
                raise spoilt(path)
        found = json.loads(head)
        between = found["between"]
        farthest = None if between is None else BetweenFrames(**between)
        return KeptFile(found["distance_mm"], farthest, found["difference"])

    def keep(self, person: PersonOfTake, name: str, path: Path, kept: KeptFile) -> None:
        """Keep a copy of a person's file, unless another package has the format: its next version may differ."""
        if name in PLUGINS:
            return
        piece = self._scratch / f"piece-{person.track.track_id}-{name}"
        with piece.open("wb") as file:
            file.write(json.dumps(asdict(kept)).encode() + b"\n")
            file.write(path.read_bytes())
        self._pieces.keep(self._key(person, name), piece)

    def _key(self, person: PersonOfTake, name: str) -> str:
        if self._digested is None or self._digested[0] is not person:
            unnamed = replace(person, motion=replace(person.motion, name=_NOBODY), floor=None, others=())
            self._digested = person, self._pieces.key(unnamed)
        holds_name = any(
            name == export and find_writer(export).holds_name for export in formats_of_people(FILE_FORMATS)
        )
        named = person.motion.name if holds_name else _NOBODY
        # Forces depend on the floor, and on people who may touch the person.
        others = (part for other in person.others for part in (other.start_frame, other.xyz_m))
        of_take = (person.floor, *others) if name == "forces" or (name == "c3d" and person.has_forces) else ()
        return self._pieces.key(name, self._digested[1], named, *of_take)


class TakeInPieces:
    """Report and viewers' files of a whole take: edits change them, names do not.

    See ``FilesInPieces``; ``edits`` are the edits of the take.
    """

    def __init__(self, pieces: Pieces, scratch: Path, edits: Sequence[PeopleEdit]) -> None:
        self._pieces, self._scratch = pieces, scratch
        self._edits = json.dumps([edit_document(edit) for edit in without_names(edits)])

    def report(self, take: Reconstruction, views: GetViews) -> dict[str, Any]:
        """Content of ``metrics.json`` but for the distances in files."""
        content = self._pieces.find(self._key(METRICS))
        if content is None:
            content = encode_report(quality_report(take, views(take)))
            self._keep(METRICS, content)
        report: dict[str, Any] = json.loads(content)
        return report

    def viewer_files(self, take: Reconstruction, make: Callable[[], Iterable[ResultFile]]) -> Sequence[ResultFile]:
        """Files for viewers; ``make`` makes them in the folder for temporary files if they are not kept."""
        contents = {name: self._pieces.find(self._key(name)) for name in (MOTION, DESCRIPTION)}
        kept = {name: content for name, content in contents.items() if content is not None}
        if len(kept) < len(contents):
            files = list(make())
            for file in files:
                self._keep(file.name, file.path.read_bytes())
            return files
        kept[DESCRIPTION] = with_names(kept[DESCRIPTION], take.motions)
        for name, content in kept.items():
            (self._scratch / name).write_bytes(content)
        return viewer_files_in(self._scratch)

    def _key(self, name: str) -> str:
        return self._pieces.key(name, self._edits)

    def _keep(self, name: str, content: bytes) -> None:
        piece = self._scratch / f"piece-{name}"
        piece.write_bytes(content)
        self._pieces.keep(self._key(name), piece)


def _feed(update: Callable[[bytes], None], value: object) -> None:
    """Feed a value to a digest, with its type and shape, so that different values never look alike."""
    if isinstance(value, np.ndarray):
        update(f"array {value.dtype.str} {value.shape} ".encode())
        update(np.ascontiguousarray(value).tobytes())
        return
    parts: tuple[object, ...] | None = None
    if is_dataclass(value):
        parts = tuple(getattr(value, field.name) for field in fields(value))
        update(f"record {len(parts)} ".encode())
    elif isinstance(value, tuple):
        parts = value
        update(f"tuple {len(parts)} ".encode())
    if parts is None:
        text = repr(value)
        update(f"{type(value).__name__} {len(text)} {text} ".encode())
        return
    for part in parts:
        _feed(update, part)
