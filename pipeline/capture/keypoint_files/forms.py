"""Forms of keypoint files: the reader of a file, found by its ending and its content."""

from functools import cache
from pathlib import Path
from typing import Any

from pipeline.capture.keypoint_files import readers
from pipeline.capture.keypoint_files.keypoint_reader import KeypointReader
from pipeline.capture.keypoint_files.people import KeypointsError
from pipeline.core.parsing import UnreadableError
from pipeline.core.runtime.plugins import load_readers

TEXT = ".txt"
"""Ending of YOLO's labels, and of notes."""


@cache
def keypoint_readers() -> tuple[KeypointReader, ...]:
    """Readers by their ranks; of one rank, readers of other packages come first."""
    return tuple(sorted(load_readers(KeypointReader, readers), key=lambda reader: reader.rank))


@cache
def endings() -> frozenset[str]:
    """Endings of keypoint files, in lower case; without texts."""
    return frozenset(suffix for reader in keypoint_readers() for suffix in reader.suffixes) - {TEXT}


@cache
def frame_endings() -> frozenset[str]:
    """Endings of files that all have a single frame, or may have one; without texts."""
    single = (reader for reader in keypoint_readers() if reader.split_frames is None)
    return frozenset(suffix for reader in single for suffix in reader.suffixes) - {TEXT}


def list_readers(path: Path) -> list[KeypointReader]:
    """Readers of files with an ending, by their ranks."""
    return [reader for reader in keypoint_readers() if path.suffix.lower() in reader.suffixes]


def load(path: Path, max_bytes: int) -> Any:
    """Content of a file as its readers take it: parsed JSON, bytes, an array; see ``KeypointReader.load``."""
    if path.stat().st_size > max_bytes:
        raise KeypointsError(f"The file is larger than {max_bytes // 2**20} MiB.")
    return list_readers(path)[-1].load(path)


def find_reader(path: Path, content: Any) -> KeypointReader:
    """Find the reader of a file by its content.

    Raises ``KeypointsError`` if JSON has the fields of several formats, ``UnreadableError`` if no format has such
    content.
    """
    known = list_readers(path)
    if isinstance(content, dict):
        owners = {reader: field for reader in known for field in reader.fields if field in content}
        if len(owners) > 1:
            named = sorted((reader.name, field) for reader, field in owners.items())
            shown = " and ".join(f"{field} of {name}" for name, field in named)
            raise KeypointsError(f"The file has the fields of several formats: {shown}. Keep one of them.")
        if owners:
            return next(iter(owners))
    for reader in known:
        if reader.is_content is None or reader.is_content(content):
            return reader
    raise UnreadableError
