"""Recordings: rooms in which browsers of phones record takes, with their phones, takes and clips."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from typing import Any


class TakeState(StrEnum):
    """State of a take."""

    RECORDING = "recording"  # phones record, or are about to
    RECORDED = "recorded"  # its clips are on the phones, or on their way
    USED = "used"  # a session or a calibration was made from it
    DISCARDED = "discarded"


@dataclass(frozen=True, slots=True)
class RecordingPhone:
    """A phone of a recording."""

    number: int
    name: str  # Of the camera in sessions; unique among the phones of the recording
    device: str  # Name that its browser states
    joined_at: datetime
    is_removed: bool  # True if the host has removed it; it can't come back


@dataclass(frozen=True, slots=True)
class ClipFile:
    """A part of a clip that was uploaded. A reload of the phone's page in the middle of a take begins another part."""

    part: int
    upload_id: str
    num_bytes: int
    first_frame_s: float  # Time of its first frame, by the service's clock
    std_s: float  # Standard deviation of that time
    duration_s: float
    facts: Mapping[str, Any]  # Further statements of the phone: size, rate, numbers of frames, losses


@dataclass(frozen=True, slots=True)
class TakeClip:
    """Clip of a take by one phone."""

    phone: int
    started: Mapping[str, Any] | None  # Message of the phone when it began; ``None``: none
    stopped: Mapping[str, Any] | None  # Message of the phone when it ended
    files: tuple[ClipFile, ...]  # By their parts

    @property
    def longest(self) -> ClipFile | None:
        """Part that a session takes; ``None`` until there is one. A session's videos have no gaps."""
        return max(self.files, key=lambda file: (file.duration_s, -file.part), default=None)


@dataclass(frozen=True, slots=True)
class RecordingTake:
    """A take of a recording, from a start to its stop, in seconds since 1970 by the service's clock."""

    number: int
    name: str
    start_s: float
    stop_s: float  # Until the take is stopped, the latest possible stop
    is_stopped: bool
    settings: Mapping[str, Any]  # Size and rate of the video that phones are asked for; empty: what they can
    is_upload_wanted: bool
    is_discarded: bool
    session_id: str | None
    job_id: str | None
    calibration_id: str | None
    clips: tuple[TakeClip, ...] = ()

    @property
    def is_used(self) -> bool:
        """Return whether its uploads became files of a session."""
        return self.session_id is not None or self.calibration_id is not None

    @property
    def duration_s(self) -> float:
        """Seconds from the start to the stop."""
        return self.stop_s - self.start_s

    def state(self, now_s: float) -> TakeState:
        """State at a time by the service's clock."""
        if self.is_discarded:
            return TakeState.DISCARDED
        if self.is_used:
            return TakeState.USED
        return TakeState.RECORDED if self.is_stopped or now_s >= self.stop_s else TakeState.RECORDING

    def clip(self, phone: int) -> TakeClip | None:
        """Clip of a phone."""
        return next((clip for clip in self.clips if clip.phone == phone), None)


@dataclass(frozen=True, slots=True)
class RecordingSession:
    """A recording: a host opens it, phones join it by its link, and it ends at ``expires_at``."""

    id: str
    name: str
    created_at: datetime
    expires_at: datetime
    revision: int  # Number of changes of the recording with its phones, takes and clips
    phones: tuple[RecordingPhone, ...] = ()
    takes: tuple[RecordingTake, ...] = ()

    def phone(self, number: int) -> RecordingPhone | None:
        """Phone with a number."""
        return next((phone for phone in self.phones if phone.number == number), None)

    def take(self, number: int) -> RecordingTake | None:
        """Take with a number."""
        return next((take for take in self.takes if take.number == number), None)


@dataclass(frozen=True, slots=True)
class JoinedPhone:
    """Recording that a phone has just joined, its number, and when, in seconds since 1970 by the database's clock."""

    recording: RecordingSession
    number: int
    at_s: float


@dataclass(frozen=True, slots=True)
class JoinLink:
    """Link by which phones join a recording, and send their uploads; it opens nothing else."""

    id: str
    recording_id: str
    tenant: str


@dataclass(frozen=True, slots=True)
class UploadingPhone:
    """Phone that sends uploads, and how much the phones of its recording may send."""

    recording_id: str
    number: int
    max_uploads: int  # Unused uploads of the recording
    max_bytes: int  # Of these


@dataclass(frozen=True, slots=True)
class RecordingLimits:
    """Limits of a recording, which the service sets."""

    phones: int
    takes: int
    take_s: float  # Longest duration of a take
