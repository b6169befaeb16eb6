"""Files of a capture in a folder: videos, and the calibration."""

from dataclasses import dataclass
from pathlib import Path

from api.blender.extension.answers import RequestError

VIDEO_ENDINGS = frozenset({".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", ".ts", ".mts", ".m2ts", ".mpg", ".mpeg"})
"""Endings of videos."""
_CALIBRATION_ENDINGS = frozenset(
    {".toml", ".json", ".txt", ".xml", ".xcp", ".yml", ".yaml", ".npz", ".pickle", ".pkl", ".zip", ".calib"}
)
_MIN_VIDEOS = 2


@dataclass(frozen=True, slots=True)
class CaptureFiles:
    """Files of a capture that is to be sent."""

    videos: tuple[Path, ...]
    calibration: Path

    @property
    def num_bytes(self) -> int:
        """Size of all files."""
        return sum(path.stat().st_size for path in (*self.videos, self.calibration))


def find_capture(folder: Path, calibration: Path | None = None) -> CaptureFiles:
    """Find the videos of a folder, and the calibration: the file that is given, or the only one of the folder.

    Raises ``RequestError`` if there are too few videos, or not exactly one calibration.
    """
    if not folder.is_dir():
        raise RequestError("Choose the folder with the videos.")
    # Names with a dot in front are copies that macOS keeps of attributes.
    paths = sorted(path for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))
    videos = tuple(path for path in paths if path.suffix.lower() in VIDEO_ENDINGS)
    if len(videos) < _MIN_VIDEOS:
        raise RequestError(f"The folder {folder.name} has {len(videos)} videos. It needs one of each camera.")
    if calibration is None:
        found = [path for path in paths if path.suffix.lower() in _CALIBRATION_ENDINGS]
        if len(found) != 1:
            names = f": {', '.join(path.name for path in found[:5])}" if found else ""
            raise RequestError(f"The folder has {len(found)} files that may be a calibration{names}. Choose one.")
        calibration = found[0]
    if not calibration.is_file():
        raise RequestError(f"There is no file {calibration.name}.")
    return CaptureFiles(videos, calibration)
