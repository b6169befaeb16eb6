"""Capture sessions and their files, uploads, which become files of sessions, and calibrations."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Literal

from pipeline.capture.preflight_record import Preflight
from pipeline.core.options.config import DEFAULT_CHUNK_FRAMES
from pipeline.core.options.edits import PeopleEdit
from worker.store.model.job_records import JobProblem, NewestJob
from worker.store.model.states import JobState


@dataclass(frozen=True, slots=True)
class InputFile:
    """A file of a session, in the artifact store under ``key``."""

    name: str
    kind: str  # "video", "keypoints", "calibration" or "timestamps"
    key: str
    num_bytes: int
    sha256: str


@dataclass(frozen=True, slots=True)
class Upload:
    """A file that arrives in pieces: a client sends it, or the service fetches it from a URL.

    ``num_bytes`` is its complete size, ``metadata`` a text of the client, ``spool`` the host and folder that hold the
    bytes that have arrived. The size of a file that is fetched is 0 until the source has answered.
    """

    id: str
    name: str
    num_bytes: int
    metadata: str
    expires_at: datetime
    spool: str
    is_fetching: bool = False
    fetched_bytes: int = 0  # Of a fetch, some seconds ago: the size of the file is the offset
    problem: JobProblem | None = None  # Why the fetch failed

    @property
    def is_size_unknown(self) -> bool:
        """True if the source has not stated the size of the file yet."""
        return self.is_fetching and self.num_bytes == 0


@dataclass(frozen=True, slots=True)
class Fetch:
    """Upload that an API process fetches; ``url`` is a secret, ``validator`` an ETag or a date of the source."""

    upload: Upload
    tenant: str
    url: str = field(repr=False)
    validator: str | None


Purpose = Literal["capture", "calibration"]
SessionState = Literal["fetching", "ready", "failed"]


@dataclass(frozen=True, slots=True)
class FetchedSession:
    """Session whose videos the service has fetched, as far as it can, and whose files are to be checked."""

    session_id: str
    tenant: str
    purpose: Purpose
    body: Mapping[str, Any]  # Request of the client, with ids of uploads in place of URLs
    uploads: tuple[Upload, ...]


@dataclass(frozen=True, slots=True)
class SessionEdits:
    """Edits of the people of a session; ``revision`` is the number of times that the list was changed."""

    revision: int = 0
    edits: tuple[PeopleEdit, ...] = ()


@dataclass(frozen=True, slots=True)
class Session:
    """A capture session: its files, and their preflight."""

    id: str
    name: str
    created_at: datetime
    files: tuple[InputFile, ...]
    preflight: Preflight
    metadata: Mapping[str, Any] = field(default_factory=dict)  # JSON object of the client
    # Digest of the file that the preflight wrote for the workers; ``None``: it is read without a comparison
    record_sha256: str | None = None
    # Videos of a ``calibration`` that is made of them have guessed cameras; they are not listed among the captures
    purpose: Purpose = "capture"
    # Time at which its videos and their pictures were deleted; ``None``: they are there, or it has keypoints
    videos_deleted_at: datetime | None = None
    chunk_frames: int = DEFAULT_CHUNK_FRAMES  # Frames of a camera in a chunk of each of its jobs
    # Request of a session whose videos are fetched; its preflight is empty until they are there
    arrival: Mapping[str, Any] | None = None
    errors: tuple[Mapping[str, Any], ...] = ()  # Why fetched files can't be used, as the web API describes errors

    @property
    def state(self) -> SessionState:
        """State of its files."""
        return "failed" if self.errors else "ready" if self.arrival is None else "fetching"

    @property
    def stored_files(self) -> tuple[InputFile, ...]:
        """Files that are in the artifact store."""
        return tuple(file for file in self.files if self.videos_deleted_at is None or file.kind != "video")


@dataclass(frozen=True, slots=True)
class Capture:
    """A session with its reconstructions and its proxies."""

    session: Session
    uploads: tuple[Upload, ...] = ()  # That it waits for
    # Number of reconstructions, and the newest one; ``None`` without any
    num_jobs: int = 0
    newest_job: NewestJob | None = None
    proxies: frozenset[str] = (
        frozenset()
    )  # Names of the proxies that are made; see ``pipeline.core.options.job_choices.proxy_name``
    proxies_job: NewestJob | None = None  # Job that makes proxies; ``None``: no job had to
    # A reconstruction blurs faces; no proxies are made
    blurs_faces: bool = False
    # No picture of the session is shown as it was sent: it blurs faces. But while its first blurred videos are made, a
    # session that an earlier reconstruction has shown stays as it is
    is_blurred: bool = False
    # Names of the blurred videos that are made; see ``pipeline.core.options.job_choices.blurred_name``
    blurred: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Calibration:
    """A calibration: sent as a file, made from a scene at once, or made by the job of the same id."""

    id: str
    name: str
    method: str  # ``file``, ``board``, ``people`` or ``scene``
    created_at: datetime
    # Of a file its name, format, units, axes and notes; else the choices with which it is made
    source: Mapping[str, Any]
    text: str | None  # The calibration in Multicap's format; ``None`` until it is made
    report: Mapping[str, Any] | None  # See ``pipeline.calibration.report.report_document``; ``None`` of a file
    session_id: str | None = None  # Session from which it is made; it may be deleted since
    # State and problem of the job that makes it; ``None`` of a file, or once the job is deleted
    job_state: JobState | None = None
    problem: JobProblem | None = None


@dataclass(frozen=True, slots=True)
class MadeCalibration:
    """Calibration that a job has made; fields like ``Calibration``."""

    text: str
    report: Mapping[str, Any]
