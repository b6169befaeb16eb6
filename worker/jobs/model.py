"""Records of the job store: sessions, jobs, chunks, keys; states and their legal transitions.

::

    job     queued -> running -> succeeded | failed
            queued | running -> canceling -> canceled
            failed | canceled -> queued          (retry: attempt + 1)
            all but expired -> queued            (edits of people: attempt + 1, revision + 1)
            succeeded | failed | canceled -> expired

    chunk   waiting -> ready -> running -> done
            running -> ready                     (lease lost, or a failure worth another try)
            running -> waiting, done -> ready    (the output of the latter is damaged, and the former needs it)
            running -> failed
            waiting | ready | running -> canceled
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from enum import IntEnum, StrEnum
from typing import Any, Literal

from pipeline.calibration_choices import CalibrationChoices
from pipeline.capture.preflight_record import Preflight
from pipeline.config import ReconstructionConfig
from pipeline.edits import PeopleEdit, PersonSpan
from pipeline.findings import Finding
from pipeline.video.playback.choices import ProxyChoices
from pipeline.visual_choices import VisualChoices
from worker.jobs.spec import JobSpec


class JobState(StrEnum):
    """State of a job."""

    QUEUED = "queued"
    RUNNING = "running"
    CANCELING = "canceling"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELED = "canceled"
    EXPIRED = "expired"


class ChunkState(StrEnum):
    """State of a chunk."""

    WAITING = "waiting"
    READY = "ready"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    CANCELED = "canceled"


JOB_TRANSITIONS: Mapping[JobState, frozenset[JobState]] = {
    JobState.QUEUED: frozenset({JobState.RUNNING, JobState.CANCELING, JobState.FAILED, JobState.QUEUED}),
    JobState.RUNNING: frozenset({JobState.SUCCEEDED, JobState.FAILED, JobState.CANCELING, JobState.QUEUED}),
    JobState.CANCELING: frozenset({JobState.CANCELED, JobState.QUEUED}),
    JobState.SUCCEEDED: frozenset({JobState.QUEUED, JobState.EXPIRED}),
    JobState.FAILED: frozenset({JobState.QUEUED, JobState.EXPIRED}),
    JobState.CANCELED: frozenset({JobState.QUEUED, JobState.EXPIRED}),
    JobState.EXPIRED: frozenset(),
}

RETRYABLE = frozenset({JobState.FAILED, JobState.CANCELED})
EDITABLE = frozenset(JobState) - {JobState.EXPIRED}
"""States of jobs whose people can be edited, if they have been found."""
CANCELABLE = frozenset({JobState.QUEUED, JobState.RUNNING})
AT_WORK = (JobState.QUEUED, JobState.RUNNING)
"""States of jobs that have chunks to claim."""


class Precedence(IntEnum):
    """Order of a tenant's work: edits of people before all other work."""

    EDITS = 0
    OTHERS = 1


FINISHED = frozenset({JobState.SUCCEEDED, JobState.FAILED, JobState.CANCELED, JobState.EXPIRED})


class Scope(StrEnum):
    """Permission of a key; no scope includes another one."""

    READ = "read"  # read the tenant's sessions, jobs and results
    WRITE = "write"  # add, change and delete them
    ADMIN = "admin"  # read figures of the whole service


@dataclass(frozen=True, slots=True)
class Key:
    """Key of the service. Requests with the key reach the records of ``tenant``."""

    id: str
    tenant: str
    name: str
    scopes: frozenset[Scope]
    created_at: datetime
    expires_at: datetime | None
    revoked_at: datetime | None


@dataclass(frozen=True, slots=True)
class Actor:
    """Key and request of an action; both ``None`` at the command line, and the key if the service has no keys."""

    key_id: str | None = None
    request_id: str | None = None


@dataclass(frozen=True, slots=True)
class AuditEvent:
    """Action on a session, a job, an upload or a key, whose id is ``subject``.

    Values of ``act``: ``worker.jobs.repositories.audit.AuditAction``.
    """

    done_at: datetime
    tenant: str
    actor: Actor
    act: str
    subject: str


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
    """A file that arrives in pieces.

    ``num_bytes`` is its complete size, ``metadata`` a text of the client, ``spool`` the host and folder that hold the
    bytes that have arrived; ``None``: upload of an older version.
    """

    id: str
    name: str
    num_bytes: int
    metadata: str
    expires_at: datetime
    spool: str | None


Purpose = Literal["capture", "calibration"]


@dataclass(frozen=True, slots=True)
class Session:
    """A capture session: its files, and what the preflight found in them.

    Parameters
    ----------
    metadata
        JSON object of the client.
    record_sha256
        Digest of the file that the preflight wrote for the workers; ``None`` for sessions of older versions.
    purpose
        Videos of a ``calibration`` that is made of them have guessed cameras; they are not listed among the captures.
    """

    id: str
    name: str
    created_at: datetime
    files: tuple[InputFile, ...]
    preflight: Preflight
    metadata: Mapping[str, Any] = field(default_factory=dict)
    record_sha256: str | None = None
    purpose: Purpose = "capture"


@dataclass(frozen=True, slots=True)
class NewestJob:
    """Job of a session that was queued last."""

    id: str
    state: JobState


@dataclass(frozen=True, slots=True)
class Capture:
    """A session with its reconstructions and its proxies.

    Parameters
    ----------
    num_jobs, newest_job
        Number of reconstructions, and the newest one; ``None`` without any.
    proxies
        Names of the proxies that are made; see ``pipeline.video.playback.choices.proxy_name``.
    proxies_job
        Job that makes proxies; ``None``: no job had to.
    """

    session: Session
    num_jobs: int = 0
    newest_job: NewestJob | None = None
    proxies: frozenset[str] = frozenset()
    proxies_job: NewestJob | None = None


@dataclass(frozen=True, slots=True)
class ChunkPlan:
    """A chunk to be worked on. Its progress counts ``unit_count`` units, such as frames of a camera."""

    index: int
    payload: Mapping[
        str, Any
    ]  # JSON object; in a map {"start_frame", "stop_frame"}, and "camera" for chunks of a camera
    unit_count: int
    output_key: str  # content-addressed key of its output, without the prefix of the session


@dataclass(frozen=True, slots=True)
class StagePlan:
    """A stage: its chunks may run at once; it becomes ready when the stage before it is done.

    Parameters
    ----------
    name
        As in ``pipeline.stages.plan``.
    chunks
        At least one; may be iterated more than once. There may be thousands, so a plan derives them one at a time.
    code_sha256
        Digest of the code that can run the chunks, as in ``pipeline.stages.code``.
    """

    name: str
    chunks: Iterable[ChunkPlan]
    code_sha256: str


@dataclass(frozen=True, slots=True)
class Problem:
    """Problem of a job: a stable code, and a sentence for the client without texts of exceptions or paths."""

    code: str
    detail: str
    stage: str | None = None
    camera: str | None = None
    hint: str | None = None
    retryable: bool = False


def is_worth_a_retry(state: JobState, problem: Problem | None) -> bool:
    """Whether another attempt of a job may succeed: the job was canceled, or its problem is retryable."""
    return state in RETRYABLE and (problem is None or problem.retryable)


@dataclass(frozen=True, slots=True)
class Stage:
    """Progress of a stage; ``done`` and ``total`` are in the units of its chunks."""

    name: str
    state: ChunkState
    done: int
    total: int
    started_at: datetime | None
    finished_at: datetime | None
    reused: bool


@dataclass(frozen=True, slots=True)
class Result:
    """A result file of a job, in the artifact store under ``key``; ``revision`` is that of the edits it shows.

    ``person`` is the number of a person as in the file's name, ``person_name`` the name that edits gave, or else the
    same.
    """

    name: str
    kind: str  # "bvh", "skeletons", "metrics"
    person: str | None
    media_type: str
    key: str
    num_bytes: int
    sha256: str
    revision: int = 0
    person_name: str | None = None


@dataclass(frozen=True, slots=True)
class Calibration:
    """A calibration: sent as a file, or made by the job of the same id.

    Parameters
    ----------
    method
        ``file``, ``board`` or ``people``.
    source
        Of a file its name, format, units, axes and notes; else the choices with which it is made.
    files
        Text by format; ``None`` until it is made.
    report
        See ``pipeline.calibration.report.report_document``; ``None`` of a file.
    session_id
        Session from which it is made; it may be deleted since.
    job_state, problem
        State and problem of the job that makes it; ``None`` of a file, or once the job is deleted.
    """

    id: str
    name: str
    method: str
    created_at: datetime
    source: Mapping[str, Any]
    files: Mapping[str, str] | None
    report: Mapping[str, Any] | None
    session_id: str | None = None
    job_state: JobState | None = None
    problem: Problem | None = None


@dataclass(frozen=True, slots=True)
class MadeCalibration:
    """Calibration that a job has made; fields as of ``Calibration``."""

    files: Mapping[str, str]
    report: Mapping[str, Any]


JobKind = Literal["reconstruction", "calibration", "proxies", "visuals"]
SIDE_KINDS: frozenset[JobKind] = frozenset({"proxies", "visuals"})
"""Kinds of jobs beside a reconstruction: in no list unless asked for, and in no quota of unfinished jobs."""
Making = CalibrationChoices | ProxyChoices | VisualChoices
"""Choices of a job that makes something else than a reconstruction."""


def kind_of(making: Making | None) -> JobKind:
    """Kind of a job by what it makes."""
    match making:
        case None:
            return "reconstruction"
        case CalibrationChoices():
            return "calibration"
        case ProxyChoices():
            return "proxies"
        case VisualChoices():
            return "visuals"


@dataclass(frozen=True, slots=True)
class Job:
    """A reconstruction of a session, the making of a calibration from it, of proxies of its videos, or of visuals.

    ``progress`` never goes back within an attempt. ``eta_s`` is an estimate of the remaining time, as if all remaining
    units took as long as the finished ones; ``None`` before any is finished. ``waiting_for`` is the outage that keeps
    its work waiting. ``warnings`` are sentences, and include those of ``result_warnings``. ``making`` has the choices
    of what it makes; without it, the job reconstructs. ``edits`` are the edits of its people, ``revision`` the number
    of times that they were changed, and ``people`` those whom the reconstruction found, before any edit; ``None`` until
    its first results are written. ``results_revision`` is the revision whose files can be read, while those of a newer
    one are made; ``None`` before the first success. ``has_old_visuals``: overlay videos or the report are of
    an earlier revision, and no job makes them; ``visuals_job`` is the job that does.
    """

    id: str
    session_id: str
    session_name: str
    num_frames: int  # output frames of the session; ``duration_s`` likewise
    duration_s: float
    state: JobState
    spec: JobSpec
    attempt: int
    stages: tuple[Stage, ...]
    progress: float
    queue_position: int | None
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None
    expires_at: datetime | None
    eta_s: float | None
    problem: Problem | None
    waiting_for: Problem | None
    warnings: tuple[str, ...]
    result_warnings: tuple[Finding, ...]
    making: Making | None = None
    edits: tuple[PeopleEdit, ...] = ()
    revision: int = 0
    people: tuple[PersonSpan, ...] | None = None
    results_revision: int | None = None
    has_old_visuals: bool = False
    visuals_job: NewestJob | None = None


@dataclass(frozen=True, slots=True)
class Failure:
    """Failed try of a chunk. ``chunk_try`` counts from 1; the chunk was begun again unless its job ended."""

    stage: str
    chunk_index: int
    chunk_try: int
    problem: Problem
    failed_at: datetime


@dataclass(frozen=True, slots=True)
class Attempt:
    """Attempt of a job: the first one, or a retry, with its problem and the failed tries of its chunks."""

    attempt: int
    state: JobState
    problem: Problem | None
    queued_at: datetime
    started_at: datetime | None
    finished_at: datetime | None
    failures: tuple[Failure, ...]


@dataclass(frozen=True, slots=True)
class Usage:
    """Amounts that a tenant has of what quotas limit."""

    sessions: int
    unfinished_jobs: int
    stored_bytes: int
    uploads: int


@dataclass(frozen=True, slots=True)
class Delivery:
    """Webhook message of a job's end. ``tries`` includes the present try; ``problem`` is that of the last one."""

    id: int
    message_id: str
    job_id: str
    tenant: str
    url: str
    body: str
    due_at: datetime
    tries: int
    problem: str | None


class LinkScope(StrEnum):
    """What a link opens."""

    FILE = "file"  # one result file, or all as a zip
    VIDEO = "video"  # the video of one camera
    EVENTS = "events"  # the event stream
    JOB = "job"  # the job to look at: all of these, and what viewers read


@dataclass(frozen=True, slots=True)
class Link:
    """Link that opens something of a job without a key, until ``expires_at``.

    Parameters
    ----------
    session_id
        Session of the job.
    name
        Name of the result file or of the camera; ``None`` for scopes without one.
    """

    id: str
    tenant: str
    job_id: str
    session_id: str
    scope: LinkScope
    name: str | None
    created_at: datetime
    expires_at: datetime


@dataclass(frozen=True, slots=True)
class WebhookSecret:
    """Secret that signs webhook messages, until ``expires_at`` if there is a newer one."""

    secret: str = field(repr=False)
    created_at: datetime
    expires_at: datetime | None


@dataclass(frozen=True, slots=True)
class Removal:
    """Files of the artifact store to be removed, by the prefix of their keys."""

    id: int
    prefix: str


@dataclass(frozen=True, slots=True)
class Change:
    """Progress of a job: the id of its last event, and the number of its finished units."""

    event: int
    done: int


@dataclass(frozen=True, slots=True)
class Figures:
    """Figures of all jobs, for monitoring.

    Parameters
    ----------
    totals
        Totals by name and label; see ``worker.jobs.database.totals``.
    jobs, chunks
        Numbers by state; chunks of unfinished jobs only.
    longest_queued_s
        Time that the first job in the queue has waited; 0 without one.
    """

    totals: Mapping[tuple[str, str], float]
    jobs: Mapping[str, int]
    chunks: Mapping[str, int]
    longest_queued_s: float


@dataclass(frozen=True, slots=True)
class ChunkOutput:
    """Output of a chunk; ``sha256`` is ``None`` until the chunk is done."""

    index: int
    key: str  # as ``ChunkPlan.output_key``
    sha256: str | None


@dataclass(frozen=True, slots=True)
class KeptPiece:
    """Stored piece of an output, which later chunks of the session find by its key."""

    key: str
    sha256: str
    num_bytes: int


@dataclass(frozen=True, slots=True)
class Claim:
    """Chunk that a worker holds by a lease; reports need its ``lease_token``."""

    chunk_id: int
    job_id: str
    session_id: str
    stage: str
    index: int
    payload: Mapping[str, Any]
    unit_count: int
    output_key: str
    spec: JobSpec
    lease_token: str
    attempt: int  # try of the chunk, from 1
    job_attempt: int
    trace: str | None  # W3C traceparent of the request for the job
    making: Making | None = None  # as of ``Job``, like the next two
    edits: tuple[PeopleEdit, ...] = ()
    revision: int = 0
    of_job: str | None = None  # reconstruction of which it makes visuals

    @property
    def config(self) -> ReconstructionConfig:
        """Configuration of the job."""
        return config_of(self.spec, self.making, self.edits, self.revision)

    @property
    def listed_by(self) -> str:
        """Id of the job whose result files those of the chunk are."""
        return self.of_job or self.job_id


def config_of(
    spec: JobSpec, making: Making | None = None, edits: tuple[PeopleEdit, ...] = (), revision: int = 0
) -> ReconstructionConfig:
    """Configuration of a job by its spec, what else it makes, the edits of its people, and their number of changes.

    Visuals of people who were edited are made by a job of their own: edits don't wait for them.
    """
    config = replace(spec.config, making=making, edits=edits)
    return replace(config, overlay=False, report=False) if making is None and revision else config
