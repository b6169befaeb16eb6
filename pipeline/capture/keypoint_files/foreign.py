"""Files that are not read as keypoints: what they are by their names, and what can be read instead."""

from collections.abc import Iterable
from pathlib import PurePath
from typing import NamedTuple

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
