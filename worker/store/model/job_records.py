"""Jobs: choices, course, problems, result files, and the webhook messages of their ends."""

from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Literal

from pipeline.core.findings import Finding
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.edits import PeopleEdit
from pipeline.core.options.file_formats import FILE_FORMATS
from pipeline.core.options.job_choices import CalibrationChoices, ProxyChoices, VisualChoices
from pipeline.core.problems.code_group import Code
from pipeline.run.space import ForeseenSpace
from worker.store.model.character_records import JobCharacter
from worker.store.model.states import RETRYABLE, ChunkState, FilesState, JobState, files_state, job_state
from worker.store.spec import JobSpec

JobKind = Literal["reconstruction", "calibration", "proxies", "visuals"]
SIDE_KINDS: frozenset[JobKind] = frozenset({"proxies", "visuals"})
"""Kinds of jobs beside a reconstruction: in no list unless asked for, and in no quota of unfinished jobs."""
Making = CalibrationChoices | ProxyChoices | VisualChoices
"""Choices of a job that makes something else than a reconstruction."""


def job_kind(making: Making | None) -> JobKind:
    """Kind of a job by its choices."""
    match making:
        case None:
            return "reconstruction"
        case CalibrationChoices():
            return "calibration"
        case ProxyChoices():
            return "proxies"
        case VisualChoices():
            return "visuals"


def job_config(
    spec: JobSpec,
    making: Making | None = None,
    edits: tuple[PeopleEdit, ...] = (),
    revision: int = 0,
    character: JobCharacter | None = None,
) -> ReconstructionConfig:
    """Configuration of a job by its spec, what else it makes, the edits that it applies, and its revision.

    Visuals of files that are made again are made by a job of their own: edits don't wait for them. Blurred videos are
    made once, because edits leave them as they are. ``character`` is the one that the job moves.
    """
    digest = None if character is None else character.digest
    makes_blurred = making.blurs_videos if isinstance(making, VisualChoices) else making is None and not revision
    config = replace(
        spec.config,
        making=making,
        edits=edits,
        character=digest,
        blurs_videos=spec.blur_faces and makes_blurred,
        is_remade=revision > 0,
    )
    if making is not None or not revision:
        return config
    exports = tuple(export for export in config.exports if FILE_FORMATS[export].holds != "recording")
    return replace(config, overlay=False, report=False, exports=exports)


@dataclass(frozen=True, slots=True)
class SessionError:
    """Error that a check of a job's session found."""

    code: Code
    message: str
    camera: str | None = None
    hint: str | None = None
    file: str | None = None


@dataclass(frozen=True, slots=True)
class JobProblem:
    """Problem of a job: a stable code, and a sentence for the client without texts of exceptions or paths.

    ``errors`` are the errors of the refused session.
    """

    code: Code
    detail: str
    stage: str | None = None
    camera: str | None = None
    hint: str | None = None
    retryable: bool = False
    errors: tuple[SessionError, ...] = ()


def is_worth_a_retry(state: JobState, problem: JobProblem | None) -> bool:
    """True if another attempt of a job may succeed: the job was canceled, or its problem is retryable."""
    return state in RETRYABLE and (problem is None or problem.retryable)


@dataclass(frozen=True, slots=True)
class StageProgress:
    """Progress of a stage; ``done`` and ``total`` are in the units of its chunks."""

    name: str
    state: ChunkState
    done: int
    total: int
    started_at: datetime | None
    finished_at: datetime | None
    reused: bool
    num_chunks: int = 1
    num_workers: int = 1  # Workers that have had its chunks


@dataclass(frozen=True, slots=True)
class NewestJob:
    """Job of a session that was queued last."""

    id: str
    state: JobState


@dataclass(frozen=True, slots=True)
class JobRecord:
    """A reconstruction of a session, the making of a calibration from it, of proxies of its videos, or of visuals.

    ``progress`` never goes back within an attempt. ``eta_s`` is an estimate of the remaining time, see
    ``worker.store.database.rows``; ``None`` before any unit is finished. ``waiting_for`` is the outage that keeps
    its work waiting. ``warnings`` are about the files, the choices and the results. ``making`` has the choices of a
    calibration, of proxies or of visuals; without it, the job reconstructs. ``edits`` are the edits of its session
    that its files apply, and ``edits_revision`` is their revision; ``None`` if it leaves them out. ``revision`` is the
    number of times that its files were made again. ``results_revision`` is the revision whose files can be read, while
    newer files are made; ``None`` before the first success. ``newest_edits_revision`` is the revision of the session's
    edits. ``attempt_state`` is the state of the current attempt. ``has_old_visuals``: overlay videos, report or
    recording are missing or of an earlier revision, and no job makes them; ``visuals_job`` is the job that does.
    ``num_blurred`` is the number of its blurred videos. ``character`` is the character that it moves. ``has_videos``:
    the videos of its session, if it has any, were not deleted. ``provider`` is the identity of the execution provider
    of its networks, empty for the CPU. ``space`` is what a reconstruction was foreseen to need; ``None`` of other jobs.
    """

    id: str
    session_id: str
    session_name: str
    num_frames: int  # output frames of the session; ``duration_s`` likewise
    duration_s: float
    attempt_state: JobState
    spec: JobSpec
    attempt: int
    stages: tuple[StageProgress, ...]
    progress: float
    queue_position: int | None
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None
    expires_at: datetime | None
    eta_s: float | None
    problem: JobProblem | None
    waiting_for: JobProblem | None
    warnings: tuple[Finding, ...]
    making: Making | None = None
    edits: tuple[PeopleEdit, ...] = ()
    edits_revision: int | None = 0
    newest_edits_revision: int = 0
    revision: int = 0
    results_revision: int | None = None
    has_old_visuals: bool = False
    visuals_job: NewestJob | None = None
    num_blurred: int = 0
    character: JobCharacter | None = None
    has_videos: bool = True
    provider: str = ""
    space: ForeseenSpace | None = None

    @property
    def state(self) -> JobState:
        """State of the job."""
        return job_state(self.attempt_state, self.results_revision is not None)

    @property
    def has_people(self) -> bool:
        """True if it has reconstructed people."""
        return self.making is None and self.results_revision is not None

    @property
    def files_state(self) -> FilesState | None:
        """State of its files; ``None`` before it has succeeded, and once it is expired."""
        return files_state(self.attempt_state, self.results_revision is not None)


@dataclass(frozen=True, slots=True)
class Failure:
    """Failed try of a chunk. ``chunk_try`` counts from 1; the chunk was begun again unless its job ended."""

    stage: str
    chunk_index: int
    chunk_try: int
    problem: JobProblem
    failed_at: datetime


@dataclass(frozen=True, slots=True)
class Attempt:
    """Attempt of a job: the first one, or a retry, with its problem and the failed tries of its chunks."""

    attempt: int
    state: JobState
    problem: JobProblem | None
    queued_at: datetime
    started_at: datetime | None
    finished_at: datetime | None
    failures: tuple[Failure, ...]


@dataclass(frozen=True, slots=True)
class Result:
    """A result file of a job, in the artifact store under ``key``; ``revision`` is the revision of its edits.

    ``person`` is the number of a person, ``person_name`` the name that edits gave, or else ``person-`` and the number.
    """

    name: str
    kind: str  # "bvh", "skeletons", "metrics"
    person: int | None
    media_type: str
    key: str
    num_bytes: int
    sha256: str
    revision: int = 0
    person_name: str | None = None


@dataclass(frozen=True, slots=True)
class Delivery:
    """Webhook message of a job's end. ``tries`` includes the present try; ``problem`` is of the last try."""

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
    """Secret that signs webhook messages, until ``expires_at`` if there is a newer one."""

    secret: str = field(repr=False)
    created_at: datetime
    expires_at: datetime | None
