"""Files that are not read as keypoints: what they are by their names, and what can be read instead."""

from collections.abc import Iterable
from pathlib import PurePath
from typing import NamedTuple

_MAX_SHOWN = 3
_DLC_CSV = "Give DeepLabCut's CSV, which is read (save_as_csv=True, or analyze_videos_converth5_to_csv)."
_COCO = "Export the points as COCO's JSON, or as a CSV in DeepLabCut's form."
_PICKLE = "A pickle may run programs."
_ONLY_2D = "Give the 2D keypoints of each camera, from which these were made."
_VIDEO = "Give videos as videos: people are detected in them."


class _Kind(NamedTuple):
    """Kind of a file, and what to give instead."""

    name: str
    advice: str


_KINDS = {
    ".slp": _Kind("SLEAP's project", _COCO),
    ".pickle": _Kind("a pickle", f"{_PICKLE} {_DLC_CSV}"),
    ".pkl": _Kind("a pickle", f"{_PICKLE} Give JSON or CSV."),
    ".mat": _Kind("MATLAB's", "Give JSON or CSV."),
    ".npz": _Kind("an archive of NumPy's", "Give JSON or CSV."),
    ".parquet": _Kind("a Parquet table", "Give JSON or CSV."),
    **dict.fromkeys((".yml", ".yaml", ".xml"), _Kind("OpenPose's of --write_keypoint", "Give those of --write_json.")),
    ".c3d": _Kind("C3D, points in 3D", _ONLY_2D),
    ".trc": _Kind("TRC, points in 3D", _ONLY_2D),
    ".bvh": _Kind("BVH, a skeleton's motion", _ONLY_2D),
    ".fbx": _Kind("FBX, a skeleton's motion", _ONLY_2D),
    **dict.fromkeys((".mot", ".sto"), _Kind("OpenSim's motion", _ONLY_2D)),
    **dict.fromkeys((".mp4", ".mov", ".avi", ".mkv", ".m4v", ".webm", ".mts", ".mpg"), _Kind("a video", _VIDEO)),
    **dict.fromkeys((".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp"), _Kind("a picture", _VIDEO)),
    **dict.fromkeys((".zip", ".7z", ".rar", ".gz", ".tar"), _Kind("an archive", "Unpack it.")),
}

_HDF5 = (".h5", ".hdf5")
ENDINGS = frozenset((*_HDF5, *_KINDS))
"""Endings of these files, in lower case."""


def _kind_of(name: str) -> _Kind | None:
    suffix = PurePath(name).suffix.casefold()
    if suffix in _HDF5:
        if "sleap" in name.casefold() or name.casefold().endswith(".analysis.h5"):
            return _Kind("SLEAP's HDF5", _COCO)
        if "dlc" in name.casefold() or "collecteddata" in name.casefold():
            return _Kind("DeepLabCut's HDF5", _DLC_CSV)
        return _Kind("HDF5", f"{_DLC_CSV} For SLEAP: {_COCO}")
    return _KINDS.get(suffix)


def described(names: Iterable[str]) -> tuple[str, str] | None:
    """Sentence of the files that are known but not read, and what to give instead; ``None`` without any.

    >>> described(["camDLC_resnet50.h5", "notes.txt"])[0]
    "camDLC_resnet50.h5 is DeepLabCut's HDF5, which is not read."
    """
    of_kind: dict[_Kind, str] = {}
    for name in sorted(names):
        kind = _kind_of(name)
        if kind is not None:
            of_kind.setdefault(kind, name)
    if not of_kind:
        return None
    shown = list(of_kind.items())[:_MAX_SHOWN]
    sentences = " ".join(f"{name} is {kind.name}, which is not read." for kind, name in shown)
    return sentences, " ".join(dict.fromkeys(kind.advice for kind, _ in shown))
