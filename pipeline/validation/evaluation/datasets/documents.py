"""JSON files of benchmarks: read within limits, whatever stands at their place."""

import stat
from pathlib import Path
from typing import Any

from pipeline.capture.keypoint_files.people import MAX_PEOPLE
from pipeline.core.parsing import UnreadableError, read_json


def read_document(path: Path, max_bytes: int) -> Any:
    """Parse a JSON file.

    Raises ``UnreadableError`` with the reason if it is no file (a pipe would be waited for, and a device has no end),
    can't be opened, has more than ``max_bytes``, or is no JSON.
    """
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise UnreadableError("no file that can be opened")
        with path.open("rb") as file:
            content = file.read(max_bytes + 1)
    except OSError as error:
        raise UnreadableError("no file that can be opened") from error
    if len(content) > max_bytes:
        raise UnreadableError(f"larger than {max_bytes >> 20} MiB")
    try:
        return read_json(content)
    except UnreadableError as error:
        raise UnreadableError("no valid JSON") from error


def check_crowd(num_people: int) -> None:
    """Raise ``UnreadableError`` for more people in a picture, or at an instant, than any session may have."""
    if num_people > MAX_PEOPLE:
        raise UnreadableError(f"{num_people:,} people; at most {MAX_PEOPLE} are allowed")
