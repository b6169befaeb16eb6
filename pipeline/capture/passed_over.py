"""Files that systems and cameras put beside videos and keypoints, and that nobody means to send."""

from collections.abc import Iterable
from pathlib import Path

from pipeline.core.findings import Finding
from pipeline.core.problems.finding_codes import FILE_IGNORED

# Attributes of files and folders, by macOS in archives and on cards.
_ATTRIBUTES, _FOLDER = "._", "__macosx"
_SYSTEM_FILES = frozenset({"desktop.ini", "thumbs.db"})
# Small copies and thumbnails of GoPro and DJI; spherical videos of Insta360, whose two fisheyes no calibration fits.
_ENDINGS = frozenset({".lrv", ".lrf", ".thm", ".insv"})
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
        or (path.suffix.casefold() in _ENDINGS and not path.is_dir())
    )


def passed_over(paths: Iterable[Path]) -> list[Finding]:
    """One finding for all files that were passed over; none without any."""
    names = sorted(path.name for path in paths)
    if not names:
        return []
    shown = ", ".join(names[:_MAX_SHOWN]) + (", ..." if len(names) > _MAX_SHOWN else "")
    message = f"Passed over, as systems and cameras put them beside videos: {shown}."
    return [Finding(FILE_IGNORED, message, severity="info", evidence={"num_files": len(names)})]
