"""Files that are the parts of one recording, by their names.

Cameras begin a new file when one reaches the largest size of its card's file system. GoPro cameras name such chapters
so that their recording can be told: ``GX010119``, ``GX020119``; ``GOPR0119``, ``GP010119``; of loops ``GHAA0001``,
``GHAA0002``. People and programs write ``part 1``, ``part 2``. Other cameras number all files alike, whether they go on
or not (``C0001``, ``MVI_0001``, ``00001.MTS``, ``DJI_0001``): the parts of these have to be stated.
"""

import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from pipeline.capture.names import natural_key, nfc

_START, _END = r"(?P<head>(?:.*[^a-z0-9])?)", r"(?P<tail>(?:[^a-z0-9].*)?)"
_PATTERNS = tuple(
    re.compile(f"{_START}{pattern}{_END}", re.ASCII | re.DOTALL)
    for pattern in (
        r"(?P<kind>g[hxls])(?P<part>\d\d)(?P<file>\d{4})",
        r"(?P<kind>gopr|gp(?P<part>\d\d))(?P<file>\d{4})",
        r"(?P<kind>g[hx][a-z]{2})(?P<part>\d{4})",
        r"(?P<kind>part|pt)[ _.-]*(?P<part>\d{1,4})",
    )
)
# The first file of a recording and its other chapters, of GoPro's older cameras.
_FIRST, _CHAPTER = "gopr", "gp"


class Part(NamedTuple):
    """A file's place in its recording, by its name."""

    recording: tuple[str, ...]  # Common text of the names of all parts
    number: int


def parse_part(name: str) -> Part | None:
    """Place of a file in its recording; ``None`` if its name tells of no recording in parts.

    >>> first, second = parse_part("left_GX010119"), parse_part("left_GX020119")
    >>> second.number, second.recording == first.recording
    (2, True)
    """
    folded = nfc(name).casefold()
    for number, pattern in enumerate(_PATTERNS):
        if (match := pattern.fullmatch(folded)) is not None:
            found = match.groupdict()
            kind = _FIRST if found["kind"].startswith(_CHAPTER) else found["kind"]
            recording = (str(number), found["head"], kind, found.get("file", ""), found["tail"])
            return Part(recording, int(found["part"] or 0))
    return None


def group_parts(names: Iterable[str]) -> list[tuple[str, ...]]:
    """Sort the names of files into recordings, each with its parts in order; most recordings are one file.

    Names of files are in natural order by their first parts. Two files that are the same part are apart.
    """
    found: dict[tuple[str, ...], dict[int, str]] = {}
    alone: list[tuple[str, ...]] = []
    for name in sorted(names, key=natural_key):
        part = parse_part(name)
        if part is None or part.number in found.get(part.recording, {}):
            alone.append((name,))
        else:
            found.setdefault(part.recording, {})[part.number] = name
    recordings = [tuple(name for _, name in sorted(parts.items())) for parts in found.values()]
    return sorted([*alone, *recordings], key=lambda recording: natural_key(recording[0]))


def missing_parts(names: Sequence[str]) -> list[int]:
    """Numbers that are left out between the parts of a recording, which are in order."""
    numbers = [part.number for name in names if (part := parse_part(name)) is not None]
    return sorted(set(range(numbers[0], numbers[-1])) - set(numbers)) if numbers else []
