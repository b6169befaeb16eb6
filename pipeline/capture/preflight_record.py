"""Preflight record: what the check of a session's files found, as it is stored and sent.

``python -m pipeline.capture.preflight`` prints it, the job store keeps it with the session, and the web API and the
workers read it. So this module needs nothing but the standard library.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from pipeline.core import records
from pipeline.core.findings import Finding
from pipeline.core.options.config import Sync, Timeline

Clock = Literal["declared", "timecode", "creation_time"]
"""Clock of the videos' starts: stated offsets, timecode, or times of creation."""


@dataclass(frozen=True, slots=True)
class PreflightThumbnail:
    """Small copy of a picture, a JPEG file."""

    time_s: float  # Time of the picture on the session's clock
    num_bytes: int
    sha256: str


@dataclass(frozen=True, slots=True)
class PreflightCamera:
    """A camera with its video, or with its archive of keypoints."""

    name: str
    file: str  # Name of the file that the client sent
    size_px: tuple[int, int]  # Width and height
    frame_rate_hz: float  # Mean rate
    num_frames: int  # Number of its own frames, as against the output frames of the session
    start_time_s: float = 0.0  # Time of its first frame on the session's clock
    # Media type as which browsers play the video, at the times that the session uses; ``None`` if some don't, and for
    # keypoints
    media_type: str | None = None
    media_start_s: float = 0.0  # Time of the first frame on the clock of the video file, which players show
    # Small copies of a few pictures, ascending in time; none of keypoints. Their places are the
    # numbers in the evidence ``pictures`` of findings.
    thumbnails: tuple[PreflightThumbnail, ...] = ()
    more_files: tuple[str, ...] = ()  # Names of further files with the camera's video, whose parts they are, in order
    # Bodies in all frames of keypoints, and joints of a body; ``None`` of videos
    num_bodies: int | None = None
    num_joints: int | None = None


@dataclass(frozen=True, slots=True)
class PreflightTimebase:
    """Clock of the output frames: frame k is at ``start_time_s + k / frame_rate_hz``."""

    start_time_s: float
    frame_rate_hz: float
    num_frames: int


@dataclass(frozen=True, slots=True)
class Recording:
    """Facts about a camera's video that neither the video nor the calibration contains; or its folder of keypoints.

    Parameters
    ----------
    camera
        Name of the camera, or of its section in the calibration.
    file
        Name or path of the video file; ``None``: the video with the camera's name. Of keypoints the name of the folder.
    offset_s
        Time of the first frame, on the clock that all cameras share.
    frame_rate_hz
        Frame rate, if the timestamps of the video are wrong; ``None``: the timestamps are right.
    more_files
        Names or paths of further files in which the recording of ``file`` continues, in order.
    offset_std_s
        Standard deviation of the offset; ``None``: nothing is known of it.

    Examples
    --------
    >>> Recording("left", "GX010119.MP4", more_files=("GX020119.MP4",)).files
    ('GX010119.MP4', 'GX020119.MP4')
    """

    camera: str
    file: str | None = None
    offset_s: float = 0.0
    frame_rate_hz: float | None = None
    more_files: tuple[str, ...] = ()
    offset_std_s: float | None = None

    @property
    def files(self) -> tuple[str, ...]:
        """Names or paths of all files."""
        return () if self.file is None else (self.file, *self.more_files)


@dataclass(frozen=True, slots=True)
class LayoutRead:
    """Layout in which points without names were read, and how it was told."""

    name: str  # Name in ``layouts.FILE_LAYOUTS``
    # ``choice``: it was stated; ``number``: no other layout has as many points; ``pictures``, ``world``: by lengths of
    # people there; ``points``: the detected points are the same joints in every layout
    told_by: Literal["choice", "number", "pictures", "world", "points"]
    num_people: int = 0  # Detections of people that told it

    def __str__(self) -> str:
        """Sentence for the user."""
        how = {
            "choice": "as stated",
            "number": "told by the number of points",
            "pictures": f"told by the lengths of {self.num_people:,} people in the pictures",
            "world": f"told by the lengths of {self.num_people:,} people located by two cameras",
            "points": "whose detected points are the same in all layouts",
        }[self.told_by]
        title = self.name.upper().replace("-", "_")
        return f"The points of the people are in the order of {title} (layout {self.name}), {how}."


@dataclass(frozen=True, slots=True)
class Preflight:
    """Cameras and clock of a session, and findings about its files."""

    cameras: tuple[PreflightCamera, ...]
    timebase: PreflightTimebase
    stretches: tuple[range, ...]  # Output frames that have to be worked on, ascending; pauses lie between them
    recordings: tuple[Recording, ...] = ()  # Facts about videos that the client stated
    units: str = "m"  # Unit of lengths in the calibration: "m", "cm" or "mm"
    findings: tuple[Finding, ...] = ()  # Findings about the files, for the client
    clock: Clock = "declared"  # Clock of the videos' starts
    up: str = "z"  # Axis of the calibration that points up, such as "-y"
    # Synchronisation, and frames of the files, of jobs of the session that don't state them
    sync: Sync = "declared"
    timeline: Timeline = "take"
    layout: LayoutRead | None = None  # Layout of keypoints whose files do not name their points
    names: Mapping[str, str] = field(default_factory=dict)  # Joints by names of 3D points that the client stated
    # Facts about a laboratory's file that the client stated: clock, channel, place; empty without a file
    laboratory: Mapping[str, Any] = field(default_factory=dict)

    @property
    def duration_s(self) -> float:
        """Duration of all output frames."""
        return self.timebase.num_frames / self.timebase.frame_rate_hz

    def thumbnails(self) -> Iterator[tuple[int, int, PreflightThumbnail]]:
        """All thumbnails with the numbers of their camera and of their picture."""
        for camera, of_camera in enumerate(self.cameras):
            for number, thumbnail in enumerate(of_camera.thumbnails):
                yield camera, number, thumbnail

    @classmethod
    def from_json(cls, document: Any) -> "Preflight":
        """Read a parsed JSON object. Raises ``ValueError`` if it is no preflight record."""
        try:
            return records.from_json(cls, document or {})
        except (KeyError, TypeError) as error:
            raise ValueError("the document is no preflight record") from error

    def to_json(self) -> dict[str, Any]:
        """JSON object, whose keys are always in the same order; texts of findings are printable."""
        document: dict[str, Any] = records.to_json(
            self, lambda value, _: value.to_json() if isinstance(value, Finding) else value
        )
        return document


def thumbnail_name(camera: int, number: int) -> str:
    """Name of the file of a thumbnail, by the numbers of its camera and of the picture."""
    return f"{camera}-{number}.jpg"
