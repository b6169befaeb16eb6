"""Files of a session's videos: listed with the names by which they are paired with cameras."""

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from pipeline.capture.names import is_passed_over, passed_over
from pipeline.core.errors import Problem
from pipeline.core.findings import Finding
from pipeline.core.problems.finding_codes import FILE_IGNORED
from pipeline.core.problems.session_codes import TOO_FEW_VIDEOS
from pipeline.video.images.files import ENDINGS

_VIDEO_ENDINGS = frozenset({".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", ".ts", ".mts", ".m2ts", ".mpg", ".mpeg"})
# A folder of a camera may have the folders of its card, such as DCIM/100GOPRO.
_MAX_DEPTH = 3


@dataclass(frozen=True, slots=True)
class VideoFiles:
    """Videos, or images in place of them, and what is said of other files."""

    paths: Sequence[Path]
    # Names for the pairing with cameras, one of each path: without endings, with folders where these are needed
    names: Sequence[str]
    findings: Sequence[Finding]

    def problems(self, min_videos: int) -> list[Problem]:
        """Report that there are too few videos."""
        if len(self.paths) >= min_videos:
            return []
        found = "is one video" if self.paths else "are no videos"
        message = f"There {found}; at least {min_videos} {'are' if min_videos > 1 else 'is'} required."
        return [Problem(TOO_FEW_VIDEOS, message, hint="Provide one video of each camera.")]


def find_videos(videos: Path | Sequence[Path]) -> VideoFiles:
    """List videos: those that are given, or those in a folder.

    A folder has videos, or zips and folders of images, or a folder for each camera with its videos. Files that systems
    and cameras put beside videos are passed over; one finding names them.
    """
    if isinstance(videos, Path) and videos.is_dir():
        return _in_folder(videos)
    given = [videos] if isinstance(videos, Path) else list(videos)
    paths = [path for path in given if not is_passed_over(path)]
    counts = Counter(map(_stem, paths))
    alike = [path.absolute() for path in paths if counts[_stem(path)] > 1]
    root = Path(os.path.commonpath([path.parent for path in alike])) if alike else Path()
    names = [_stem(path) if counts[_stem(path)] == 1 else _below(root, path.absolute()) for path in paths]
    return VideoFiles(paths, names, passed_over(path for path in given if path not in paths))


def footage_in(folder: Path) -> Sequence[Path]:
    """Videos in a folder, like ``find_videos``; without any, its folders and zips of images."""
    return _in_folder(folder).paths


def _in_folder(folder: Path) -> VideoFiles:
    listed = sorted(folder.iterdir())
    entries = [path for path in listed if not path.name.startswith(".") and not is_passed_over(path)]
    files = [path for path in entries if path.is_file()]
    paths = [path for path in files if _is_video(path)] or [
        path for path in entries if path.suffix.lower() == ".zip" or _has_images(path)
    ]
    names = [_stem(path) for path in paths]
    if not paths:
        paths = [path for entry in entries if entry.is_dir() for path in _videos_below(entry, _MAX_DEPTH)]
        names = [_below(folder, path) for path in paths]
    findings = [
        Finding(FILE_IGNORED, f"{path.name} is ignored: it is not a video.", severity="info")
        for path in files
        if path not in paths
    ]
    return VideoFiles(paths, names, [*findings, *passed_over(path for path in listed if is_passed_over(path))])


def _videos_below(folder: Path, max_depth: int) -> Iterator[Path]:
    for path in sorted(folder.iterdir()):
        if path.name.startswith(".") or is_passed_over(path):
            continue
        if path.is_file() and _is_video(path):
            yield path
        elif path.is_dir() and max_depth > 1:
            yield from _videos_below(path, max_depth - 1)


def _is_video(path: Path) -> bool:
    return path.suffix.lower() in _VIDEO_ENDINGS


def _has_images(path: Path) -> bool:
    return path.is_dir() and any(file.suffix.lower() in ENDINGS for file in path.iterdir())


def _stem(path: Path) -> str:
    """Name of a video without its ending, or of a folder of images."""
    return path.name if path.is_dir() else path.stem


def _below(root: Path, path: Path) -> str:
    """Name with the folders below a root."""
    return (path.parent.relative_to(root) / _stem(path)).as_posix()
