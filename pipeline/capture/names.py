"""Names of files: cameras in them, by one rule for the command line, Python, web API and page, and files to skip.

Names are compared case-folded and as NFC, word by word; a word has letters and digits. ``api/portal/send/matching.js``
is the same rule, and the same table of cases tests both.
"""

import re
import unicodedata
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from pipeline.core.findings import Finding
from pipeline.core.problems.finding_codes import FILE_IGNORED

_RUNS = re.compile(r"[0-9]+|[^0-9]+")
_DIGITS = frozenset("0123456789")

Key = tuple[str, ...]
"""A name to compare: its runs of letters and of digits, without separators."""


def natural_key(name: str) -> tuple[list[tuple[bool, int, str]], str]:
    """Key that sorts names in natural order: digits count as numbers, and case is ignored.

    >>> sorted(["cam10", "cam2", "Cam1"], key=natural_key)
    ['Cam1', 'cam2', 'cam10']
    """
    return [(False, int(run), "") if _is_number(run) else (True, 0, run) for run in _RUNS.findall(_folded(name))], name


def words(name: str) -> list[str]:
    """Words of a name, folded.

    >>> words("Walk0001_Miqus 1")
    ['walk0001', 'miqus', '1']
    """
    letters = (character if unicodedata.category(character)[0] in "LMN" else " " for character in _folded(name))
    return "".join(letters).split()


def cameras_in_names(names: Sequence[str], cameras: Mapping[str, Sequence[str]]) -> dict[str, tuple[str, ...]]:
    """Find the cameras whose names are whole words in the name of each file.

    Of two names the longer counts, such as ``left back`` and not ``left`` in ``walk_left_back``. Leading zeros of
    numbers are ignored in names of files that have no camera's name with the same zeros. If a file has the names of
    several cameras, those in words that all files share at their start or end are ignored: they tell no camera from
    another.

    ``names``: names of the files without endings. ``cameras``: second names of each camera, by its first name. A second
    name counts unless another camera has it as its first. Returns cameras of each file, by its name: one, none, or
    several if its name is ambiguous.
    """
    exact = {nfc(second): camera for camera, seconds in cameras.items() for second in seconds if second}
    exact |= {nfc(camera): camera for camera in cameras}
    split = {name: words(name) for name in names}
    num_left, num_right = _num_shared(list(split.values()))
    found: dict[str, tuple[str, ...]] = {}
    for name, parts in split.items():
        if (camera := exact.get(nfc(name))) is not None:
            found[name] = (camera,)
            continue
        spans = _spans(parts, cameras, with_zeros=True) or _spans(parts, cameras, with_zeros=False)
        found[name] = _named(spans)
        if len(found[name]) > 1:
            telling = [span for span in spans if span.stop > num_left and span.start < len(parts) - num_right]
            found[name] = _named(telling) or found[name]
    return found


class _Span(NamedTuple):
    """Words ``start <= k < stop`` of a file's name that are the name of a camera."""

    start: int
    stop: int
    camera: str


def _named(spans: Sequence[_Span]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(span.camera for span in spans))


def _spans(parts: Sequence[str], cameras: Mapping[str, Sequence[str]], with_zeros: bool) -> list[_Span]:
    """Places of cameras' names among the words of a file's name, without those inside a longer name."""
    firsts = _by_key([(camera, camera) for camera in cameras], with_zeros)
    seconds = _by_key([(second, camera) for camera in cameras for second in cameras[camera]], with_zeros)
    known = seconds | firsts
    spans = [
        _Span(start, stop, camera)
        for start in range(len(parts))
        for stop, key in _keys_from(parts, start, max(map(len, known), default=0), with_zeros)
        for camera in known.get(key, ())
    ]
    places = {span[:2] for span in spans}
    return [
        span
        for span in spans
        if not any(start <= span.start and span.stop <= stop and (start, stop) != span[:2] for start, stop in places)
    ]


def _by_key(names: Sequence[tuple[str, str]], with_zeros: bool) -> dict[Key, list[str]]:
    """Cameras by the keys of their names; names without letters and digits are left out."""
    cameras: dict[Key, list[str]] = {}
    for name, camera in names:
        parts = words(name)
        *_, (_, key) = _keys_from(parts, 0, len(name), with_zeros) if parts else [(0, ())]
        if key:
            cameras.setdefault(key, []).append(camera)
    return cameras


def _keys_from(parts: Sequence[str], start: int, max_runs: int, with_zeros: bool) -> Iterator[tuple[int, Key]]:
    """Keys of the words ``start <= k < stop`` with each ``stop``; letters of adjoining words are one run."""
    key: list[str] = []
    for stop, part in enumerate(parts[start:], start + 1):
        for run in _RUNS.findall(part):
            if _is_number(run):
                key.append(run if with_zeros else run.lstrip("0") or "0")
            elif key and not _is_number(key[-1]):
                key[-1] += run
            else:
                key.append(run)
        if len(key) > max_runs:
            return
        yield stop, tuple(key)


def _num_shared(names: Sequence[Sequence[str]]) -> tuple[int, int]:
    """Numbers of words that all names share at their start and at their end; none if there is one name."""
    if len(names) < 2:
        return 0, 0

    def count(names: Sequence[Sequence[str]]) -> int:
        columns = enumerate(zip(*names, strict=False))
        return next((number for number, column in columns if len(set(column)) > 1), min(map(len, names)))

    return count(names), count([name[::-1] for name in names])


def _is_number(run: str) -> bool:
    return run[0] in _DIGITS


def _folded(name: str) -> str:
    return nfc(nfc(name).casefold())


def nfc(name: str) -> str:
    """Name with composed characters: file systems and programs differ in how they store accents.

    >>> nfc("Cafe\u0301") == "Caf\u00e9"
    True
    """
    return unicodedata.normalize("NFC", name)


# Attributes of files and folders, by macOS in archives and on cards.
_ATTRIBUTES, _FOLDER = "._", "__macosx"
_SYSTEM_FILES = frozenset({"desktop.ini", "thumbs.db"})
# Small copies and thumbnails of GoPro and DJI; spherical videos of Insta360, whose two fisheyes no calibration fits.
_ENDINGS = (".lrv", ".lrf", ".thm", ".insv")
_MAX_SHOWN = 6


def is_passed_over(path: Path) -> bool:
    """Return whether a file or folder is one that systems and cameras put beside others, by its name.

    >>> [is_passed_over(Path(name)) for name in ("._cam1.mp4", "__MACOSX", "GX010001.LRV", "GX010001.MP4")]
    [True, True, True, False]
    """
    name = path.name.casefold()
    return (
        name.startswith(_ATTRIBUTES)
        or name == _FOLDER
        or name in _SYSTEM_FILES
        or (name.endswith(_ENDINGS) and not path.is_dir())
    )


def passed_over(paths: Iterable[Path]) -> list[Finding]:
    """One finding for all files that were passed over; none without any."""
    names = sorted(path.name for path in paths)
    if not names:
        return []
    shown = ", ".join(names[:_MAX_SHOWN]) + (", ..." if len(names) > _MAX_SHOWN else "")
    message = f"Passed over, as systems and cameras put them beside videos: {shown}."
    return [Finding(FILE_IGNORED, message, severity="info", evidence={"num_files": len(names)})]
