"""Forms of keypoint files: the reader of a file, found by its ending and its content."""

from collections.abc import Iterable
from functools import cache, lru_cache
from pathlib import Path, PurePath
from typing import Any, NamedTuple

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


@lru_cache(maxsize=64)  # of endings that strangers choose
def list_readers(ending: str) -> list[KeypointReader]:
    """Readers of files with an ending, by their ranks."""
    return [reader for reader in keypoint_readers() if ending.lower() in reader.suffixes]


def load(path: Path, max_bytes: int) -> Any:
    """Content of a file as its readers take it: parsed JSON, bytes, an array; see ``KeypointReader.load``."""
    if path.stat().st_size > max_bytes:
        raise KeypointsError(f"The file is larger than {max_bytes // 2**20} MiB.")
    return list_readers(path.suffix)[-1].load(path)


def find_reader(path: Path, content: Any) -> KeypointReader:
    """Find the reader of a file by its content.

    Raises ``KeypointsError`` if JSON has the fields of several formats, ``UnreadableError`` if no format has such
    content.
    """
    known = list_readers(path.suffix)
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


_MAX_SHOWN = 3
_DLC = "Give DeepLabCut's table of points, which is read: its HDF5 or CSV."
_ANALYSIS = (
    "Give SLEAP's analysis file (.analysis.h5), which is read: Export Analysis HDF5 in its menu, "
    "sleap-convert --format analysis, or save_analysis_h5 of sleap-io."
)
_PICKLE = "A pickle may run programs."
_ONLY_2D = "Give the 2D keypoints of each camera, from which these were made."
_VIDEO = "Give videos as videos: people are detected in them."


class _Kind(NamedTuple):
    """Kind of a file, and what to give instead."""

    name: str
    advice: str


_KINDS = {
    ".slp": _Kind("SLEAP's project", _ANALYSIS),
    ".pickle": _Kind("a pickle", f"{_PICKLE} {_DLC}"),
    ".pkl": _Kind("a pickle", f"{_PICKLE} Give JSON or CSV."),
    ".mat": _Kind("MATLAB's", "Give JSON or CSV."),
    ".npz": _Kind("an archive of NumPy's", "Give JSON or CSV."),
    ".parquet": _Kind("a Parquet table", "Give JSON or CSV."),
    **dict.fromkeys(
        (".yml", ".yaml", ".xml"), _Kind("OpenPose's of --write_keypoint", "Give the files of --write_json.")
    ),
    ".c3d": _Kind("C3D, points in 3D", _ONLY_2D),
    ".trc": _Kind("TRC, points in 3D", _ONLY_2D),
    ".bvh": _Kind("BVH, a skeleton's motion", _ONLY_2D),
    ".fbx": _Kind("FBX, a skeleton's motion", _ONLY_2D),
    **dict.fromkeys((".mot", ".sto"), _Kind("OpenSim's motion", _ONLY_2D)),
    **dict.fromkeys((".mp4", ".mov", ".avi", ".mkv", ".m4v", ".webm", ".mts", ".mpg"), _Kind("a video", _VIDEO)),
    **dict.fromkeys((".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp"), _Kind("a picture", _VIDEO)),
    **dict.fromkeys((".zip", ".7z", ".rar", ".gz", ".tar"), _Kind("an archive", "Unpack it.")),
}

ENDINGS = frozenset(_KINDS)
"""Endings of these files, in lower case."""


def described(names: Iterable[str]) -> tuple[str, str] | None:
    """Sentence of the files that are known but not read, and what to give instead; ``None`` without any.

    >>> described(["walk.slp", "notes.txt"])[0]
    "walk.slp is SLEAP's project, which is not read."
    """
    of_kind: dict[_Kind, str] = {}
    for name in sorted(names):
        kind = _KINDS.get(PurePath(name).suffix.casefold())
        if kind is not None:
            of_kind.setdefault(kind, name)
    if not of_kind:
        return None
    shown = list(of_kind.items())[:_MAX_SHOWN]
    sentences = " ".join(f"{name} is {kind.name}, which is not read." for kind, name in shown)
    return sentences, " ".join(dict.fromkeys(kind.advice for kind, _ in shown))
