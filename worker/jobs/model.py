"""Sessions, jobs, stages and chunks: their states, and which transitions are legal.

::

    job     queued -> running -> succeeded | failed
            queued | running -> canceling -> canceled
            failed | canceled -> queued          (retry: attempt + 1)
            succeeded | failed | canceled -> expired

    chunk   waiting -> ready -> running -> done
            running -> ready                     (lease lost, or a failure worth another try)
            running -> waiting, done -> ready    (the output of the latter is damaged, and the former needs it)
            running -> failed
            waiting | ready | running -> canceled
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum
from typing import Any

from pipeline.capture.preflight_record import Preflight
from worker.jobs.spec import JobSpec


class JobState(StrEnum):
    """Where a job is in its life."""

    QUEUED = "queued"
    RUNNING = "running"
    CANCELING = "canceling"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELED = "canceled"
    EXPIRED = "expired"


class ChunkState(StrEnum):
    """Where a chunk is in its life."""

    WAITING = "waiting"
    READY = "ready"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    CANCELED = "canceled"


JOB_TRANSITIONS: Mapping[JobState, frozenset[JobState]] = {
    JobState.QUEUED: frozenset({JobState.RUNNING, JobState.CANCELING, JobState.FAILED}),
    JobState.RUNNING: frozenset({JobState.SUCCEEDED, JobState.FAILED, JobState.CANCELING}),
    JobState.CANCELING: frozenset({JobState.CANCELED}),
    JobState.SUCCEEDED: frozenset({JobState.EXPIRED}),
    JobState.FAILED: frozenset({JobState.QUEUED, JobState.EXPIRED}),
    JobState.CANCELED: frozenset({JobState.QUEUED, JobState.EXPIRED}),
    JobState.EXPIRED: frozenset(),
}

RETRYABLE = frozenset(state for state, targets in JOB_TRANSITIONS.items() if JobState.QUEUED in targets)
CANCELABLE = frozenset({JobState.QUEUED, JobState.RUNNING})
AT_WORK = (JobState.QUEUED, JobState.RUNNING)
"""States of jobs that have chunks to claim."""

FINISHED = frozenset({JobState.SUCCEEDED, JobState.FAILED, JobState.CANCELED, JobState.EXPIRED})


class Scope(StrEnum):
    """What a key is good for; none includes another."""

    READ = "read"  # see the tenant's sessions, jobs and results
    WRITE = "write"  # make, change and delete them
    ADMIN = "admin"  # see figures of the whole service


@dataclass(frozen=True, slots=True)
class Key:
    """Who may use the service. Everything that comes with it belongs to ``tenant``."""

    id: str
    tenant: str
    name: str
    scopes: frozenset[Scope]
    created_at: datetime
    expires_at: datetime | None
    revoked_at: datetime | None


@dataclass(frozen=True, slots=True)
class Actor:
    """Who does something: by which key, if one was needed, in which request; neither at the command line."""

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
    """A file that comes in pieces: ``num_bytes`` when it is whole. ``metadata`` is the client's, as it sent it."""

    id: str
    name: str
    num_bytes: int
    metadata: str
    expires_at: datetime


@dataclass(frozen=True, slots=True)
class Session:
    """A capture session: its files, and what the preflight found in them.

    Parameters
    ----------
    metadata
        JSON object of the client.
    record_sha256
        Digest of the file that the preflight wrote for the workers; ``None`` for sessions of older versions.
    """

    id: str
    name: str
    created_at: datetime
    files: tuple[InputFile, ...]
    preflight: Preflight
    metadata: Mapping[str, Any] = field(default_factory=dict)
    record_sha256: str | None = None


@dataclass(frozen=True, slots=True)
class ChunkPlan:
    """One unit of work. ``unit_count`` is what its progress counts: a camera's frames, or 1."""

    index: int
    payload: Mapping[str, Any]  # JSON: of a map {"start_frame", "stop_frame"}, and "camera" if it is of one
    unit_count: int
    output_key: str  # content-addressed key of what it will leave, without a tenant's or session's prefix


@dataclass(frozen=True, slots=True)
class StagePlan:
    """A stage: its chunks may run at once; it becomes ready when the stage before it is done.

    Parameters
    ----------
    name
        As in ``worker.stages.plan``.
    chunks
        One at least; may be iterated more than once. There may be thousands, so a plan derives them one at a time.
    code_sha256
        Digest of the code that can run them, as in ``worker.stages.code``.
    """

    name: str
    chunks: Iterable[ChunkPlan]
    code_sha256: str


@dataclass(frozen=True, slots=True)
class Problem:
    """What went wrong with a job, in the words of problem+json: never an exception's text or a path."""

    code: str
    detail: str
    stage: str | None = None
    camera: str | None = None
    hint: str | None = None
    retryable: bool = False


def is_worth_a_retry(state: JobState, problem: Problem | None) -> bool:
    """Whether another attempt of a job may succeed: it was canceled, or failed by an error that is retryable."""
    return state in RETRYABLE and (problem is None or problem.retryable)


@dataclass(frozen=True, slots=True)
class ResultWarning:
    """Warning about a result that is there: a stable code, and a sentence."""

    code: str
    message: str


@dataclass(frozen=True, slots=True)
class Stage:
    """A stage of a job as a client sees it; ``done`` and ``total`` in the units of its chunks."""

    name: str
    state: ChunkState
    done: int
    total: int
    started_at: datetime | None
    finished_at: datetime | None
    reused: bool


@dataclass(frozen=True, slots=True)
class Result:
    """A result file of a job, in the artifact store under ``key``."""

    name: str
    kind: str  # "bvh", "skeletons", "metrics"
    person: str | None
    media_type: str
    key: str
    num_bytes: int
    sha256: str


@dataclass(frozen=True, slots=True)
class Job:
    """A reconstruction of a session.

    ``progress`` never goes back within an attempt. ``eta_s`` is a guess of the time left, as if all units of work that
    are left took as long as those that were done; ``None`` before any was. ``warnings`` are sentences, those of
    ``result_warnings`` among them.
    """

    id: str
    session_id: str
    session_name: str
    num_frames: int  # of the session, as is the duration
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
    warnings: tuple[str, ...]
    result_warnings: tuple[ResultWarning, ...]


@dataclass(frozen=True, slots=True)
class Failure:
    """A try of a chunk that came to nothing. ``chunk_try`` counts from 1; it was begun again unless its job ended."""

    stage: str
    chunk_index: int
    chunk_try: int
    problem: Problem
    failed_at: datetime


@dataclass(frozen=True, slots=True)
class Attempt:
    """An attempt of a job: the first one, or a retry. ``problem`` says why it failed, ``failures`` what went before."""

    attempt: int
    state: JobState
    problem: Problem | None
    queued_at: datetime
    started_at: datetime | None
    finished_at: datetime | None
    failures: tuple[Failure, ...]


@dataclass(frozen=True, slots=True)
class Usage:
    """How much a tenant has."""

    sessions: int
    unfinished_jobs: int
    stored_bytes: int
    uploads: int


@dataclass(frozen=True, slots=True)
class Delivery:
    """A message of a job's end. ``tries`` counts the one at hand; ``problem`` is of the one before."""

    id: int
    message_id: str
    job_id: str
    tenant: str
    url: str
    body: str
    due_at: datetime
    tries: int
    problem: str | None


@dataclass(frozen=True, slots=True)
class WebhookSecret:
    """What signs messages, until ``expires_at`` if there is a newer one."""

    secret: str = field(repr=False)
    created_at: datetime
    expires_at: datetime | None


@dataclass(frozen=True, slots=True)
class Removal:
    """Files of the artifact store, by their keys' prefix, that nobody needs any more."""

    id: int
    prefix: str


@dataclass(frozen=True, slots=True)
class Change:
    """How far a job has come: the number of the last thing that happened to it, and its units of work that are done."""

    event: int
    done: int


@dataclass(frozen=True, slots=True)
class Figures:
    """What monitoring wants to know of all jobs.

    Parameters
    ----------
    totals
        Sums that only grow, by name and label; see ``worker.jobs.database.totals``.
    jobs, chunks
        How many there are by state; chunks of unfinished jobs only.
    longest_queued_s
        For how long the first job in the queue has been there; 0 without one.
    """

    totals: Mapping[tuple[str, str], float]
    jobs: Mapping[str, int]
    chunks: Mapping[str, int]
    longest_queued_s: float


@dataclass(frozen=True, slots=True)
class ChunkOutput:
    """Output of a chunk that is done; ``sha256`` is ``None`` while it is not."""

    index: int
    key: str  # as ``ChunkPlan.output_key``
    sha256: str | None


@dataclass(frozen=True, slots=True)
class Claim:
    """A chunk that a worker holds by a lease; only the holder of ``lease_token`` may report on it."""

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
    attempt: int  # of the chunk: 1 at first
    trace: str | None  # W3C traceparent of who asked for the job
