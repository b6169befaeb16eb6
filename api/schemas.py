"""Wire format of requests and responses. Nothing here is stored; the records of the domain are in ``worker.jobs``."""

import json
import unicodedata
from typing import Annotated, Any, Literal, Self
from uuid import UUID

from pydantic import AfterValidator, AwareDatetime, BaseModel, ConfigDict, Field
from pydantic_core import PydanticCustomError

from pipeline.config import Choice, Kind
from pipeline.stages.plan import STAGE_BY_NAME
from worker.jobs.database.quotas import Quotas
from worker.jobs.model import (
    CANCELABLE,
    Attempt,
    ChunkState,
    Failure,
    Job,
    JobState,
    Problem,
    Result,
    Scope,
    Session,
    Stage,
    Usage,
    is_worth_a_retry,
)
from worker.jobs.spec import JobSpec

_UUID = {"format": "uuid"}
Id = Annotated[str, Field(json_schema_extra=_UUID)]


def _printable(text: str) -> str:
    if any(unicodedata.category(character).startswith("C") for character in text):
        raise PydanticCustomError("control_characters", "Control characters are not allowed.")
    return text


def _json(value: dict[str, Any]) -> dict[str, Any]:
    """Refuse values that the parser accepts but JSON does not have, such as NaN and half surrogates."""
    try:
        json.dumps(value, allow_nan=False, ensure_ascii=False).encode()
    except ValueError:
        message = "metadata must be valid JSON: no NaN, no infinity, no half surrogates."
        raise PydanticCustomError("json_value", message) from None
    return value


class _Answer(BaseModel):
    """Base of responses."""

    model_config = ConfigDict(json_schema_serialization_defaults_required=True)


class CameraManifest(BaseModel):
    """What is known of a camera's video that neither the file nor the calibration says."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Annotated[str, AfterValidator(_printable)] = Field(
        min_length=1, max_length=64, description="Of the camera, as in the calibration."
    )
    file: Annotated[str, AfterValidator(_printable)] | None = Field(
        default=None, min_length=1, max_length=200, description="Name of its video; else the one with its name."
    )
    offset_s: float = Field(
        default=0.0,
        strict=True,
        ge=-86_400.0,
        le=86_400.0,
        allow_inf_nan=False,
        description="When its first frame was taken, on the clock that all cameras share.",
    )
    rate: float | None = Field(
        default=None,
        strict=True,
        ge=1.0,
        le=1000.0,
        allow_inf_nan=False,
        description="Frames a second, if the times in the video are wrong.",
    )


class Manifest(BaseModel):
    """What a client may say about a session beside its files. Unknown fields are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Annotated[str, AfterValidator(_printable)] = Field(
        default="untitled", min_length=1, max_length=200, description="For people."
    )
    frame_rate_hz: float | None = Field(
        default=None,
        strict=True,
        ge=1.0,
        le=1000.0,
        allow_inf_nan=False,
        description="Of keypoints without timestamps; 25 if nobody says another.",
    )
    cameras: tuple[CameraManifest, ...] = Field(
        default=(), max_length=256, description="Of sessions of videos: what is known of some cameras."
    )
    units: Literal["m", "cm", "mm"] = Field(
        default="m", description="Of the calibration, if its format does not say (TOML, and JSON with K, R, t)."
    )
    metadata: Annotated[dict[str, Any], AfterValidator(_json)] = Field(
        default={}, description="Anything; it comes back with the session."
    )


class UploadedSession(BaseModel):
    """A session whose files have been uploaded, each by the id of its upload. Unknown fields are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    videos: tuple[UUID, ...] = Field(default=(), description="One a camera.")
    keypoints: tuple[UUID, ...] = Field(
        default=(), description="Instead of videos: a zip a camera, named as the camera, of OpenPose's JSON files."
    )
    calibration: UUID = Field(description="Of all cameras.")
    timestamps: UUID | None = Field(
        default=None, description="Of keypoints: CSV with the columns camera, frame and time_s."
    )
    manifest: Manifest = Manifest()


class UploadedCapture(UploadedSession):
    """Likewise, with how it is to be reconstructed."""

    spec: JobSpec = JobSpec()


class FileOut(_Answer):
    """A file of a session."""

    name: str
    kind: str = Field(description="`video`, `keypoints`, `calibration` or `timestamps`.")
    num_bytes: int
    sha256: str


class CameraOut(_Answer):
    """A camera of the calibration with its video or its keypoints."""

    name: str
    file: str
    size_px: tuple[int, int]
    frame_rate_hz: float
    num_frames: int
    start_time_s: float = Field(default=0.0, description="When its first frame was taken.")


class TimebaseOut(_Answer):
    """The clock of the output frames: frame k is at ``start_time_s + k / frame_rate_hz``."""

    start_time_s: float
    frame_rate_hz: float
    num_frames: int


class PreflightOut(_Answer):
    """What was found in a session's files."""

    cameras: tuple[CameraOut, ...]
    timebase: TimebaseOut
    warnings: tuple[str, ...]


class SessionLinks(_Answer):
    """Where to go from a session."""

    self: str
    jobs: str


class SessionOut(_Answer):
    """A capture session."""

    id: Id
    name: str
    created_at: AwareDatetime
    files: tuple[FileOut, ...]
    num_bytes: int = Field(description="Of all files.")
    preflight: PreflightOut
    metadata: dict[str, Any]
    links: SessionLinks

    @classmethod
    def of(cls, session: Session) -> Self:
        """Build the response from a session."""
        address = f"/v1/sessions/{session.id}"
        return cls(
            id=session.id,
            name=session.name,
            created_at=session.created_at,
            files=tuple(FileOut(**_fields(file, FileOut)) for file in session.files),
            num_bytes=sum(file.num_bytes for file in session.files),
            preflight=PreflightOut.model_validate(session.preflight.to_json()),
            metadata=dict(session.metadata),
            links=SessionLinks(self=address, jobs=f"{address}/jobs"),
        )


class SessionPage(_Answer):
    """Some sessions, the newest first."""

    sessions: tuple[SessionOut, ...]
    next_cursor: str | None = Field(description="For the next page, if there may be one.")


class StageOut(_Answer):
    """A stage of a job: how many of its units are done."""

    name: str
    label: str = Field(description="Name of the stage for people.")
    state: ChunkState
    done: int
    total: int
    fraction: float = Field(ge=0, le=1)
    started_at: AwareDatetime | None
    finished_at: AwareDatetime | None
    reused: bool = Field(description="Whether it was taken from an earlier job.")

    @classmethod
    def of(cls, stage: Stage) -> Self:
        """Build the response from a stage."""
        fraction = stage.done / stage.total if stage.total else float(stage.state is ChunkState.DONE)
        label = STAGE_BY_NAME[stage.name].label
        return cls(label=label, fraction=min(1.0, fraction), **_fields(stage, cls, without=("label", "fraction")))


class JobError(_Answer):
    """Why a job failed."""

    code: str
    detail: str
    stage: str | None
    camera: str | None
    hint: str | None
    retryable: bool

    @classmethod
    def of(cls, problem: Problem) -> Self:
        """Build the response from a problem."""
        return cls(**_fields(problem, cls))


class FailureOut(_Answer):
    """A try of a piece of work that came to nothing."""

    stage: str
    chunk: int = Field(description="Which piece of the stage, from 0.")
    chunk_try: int = Field(description="Which try of it, from 1.")
    failed_at: AwareDatetime
    reason: JobError

    @classmethod
    def of(cls, failure: Failure) -> Self:
        """Build the response from a failure."""
        return cls(
            chunk=failure.chunk_index,
            reason=JobError.of(failure.problem),
            **_fields(failure, cls, without=("chunk", "reason")),
        )


class AttemptOut(_Answer):
    """An attempt of a job: the first one, or a retry."""

    attempt: int
    state: JobState
    queued_at: AwareDatetime
    started_at: AwareDatetime | None
    finished_at: AwareDatetime | None
    error: JobError | None = Field(description="Why it failed.")
    failures: tuple[FailureOut, ...] = Field(description="What was tried again, and what ended it, in order.")

    @classmethod
    def of(cls, attempt: Attempt) -> Self:
        """Build the response from an attempt."""
        return cls(
            error=JobError.of(attempt.problem) if attempt.problem else None,
            failures=tuple(FailureOut.of(failure) for failure in attempt.failures),
            **_fields(attempt, cls, without=("error", "failures")),
        )


class AttemptList(_Answer):
    """All attempts of a job, the first one first."""

    attempts: tuple[AttemptOut, ...]


class WarningOut(_Answer):
    """A warning about a result."""

    code: str = Field(description="Stable, such as `few_views`.")
    message: str = Field(description="For people.")


class JobLinks(_Answer):
    """Where to go from a job."""

    self: str
    session: str
    attempts: str
    events: str
    results: str
    results_zip: str
    cancel: str | None = Field(description="Null once it is canceled or finished.")
    retry: str | None = Field(
        description="Null unless another attempt makes sense: it was canceled, or failed by an error that is retryable."
    )


class JobOut(_Answer):
    """A reconstruction of a session."""

    id: Id
    session_id: Id
    session_name: str
    num_frames: int = Field(description="Output frames of the session; `spec.frame_range` may take some of them.")
    duration_s: float = Field(description="Length of the session: its frames by its frame rate.")
    state: JobState
    spec: JobSpec
    attempt: int
    stages: tuple[StageOut, ...]
    progress: float = Field(ge=0, le=1, description="Never goes back within an attempt.")
    queue_position: int | None = Field(description="Its place in the queue, from 1; null once it runs.")
    eta_s: float | None = Field(
        ge=0, description="A guess of the seconds left, from the work that is done; null before any is, and at the end."
    )
    created_at: AwareDatetime
    started_at: AwareDatetime | None
    finished_at: AwareDatetime | None
    expires_at: AwareDatetime | None = Field(description="When results go; null if they stay until they are deleted.")
    error: JobError | None
    warnings: tuple[str, ...] = Field(
        description="Warnings about the files, the choices and, once finished, the result."
    )
    result_warnings: tuple[WarningOut, ...] = Field(
        description="Those of `warnings` that are of the result, such as `nobody_found`; docs/conventions.md has all."
    )
    links: JobLinks

    @classmethod
    def of(cls, job: Job) -> Self:
        """Build the response from a job."""
        address = f"/v1/jobs/{job.id}"
        return cls(
            **_fields(job, cls, without=("stages", "error", "result_warnings", "links")),
            stages=tuple(StageOut.of(stage) for stage in job.stages),
            error=JobError.of(job.problem) if job.problem else None,
            result_warnings=tuple(WarningOut(**_fields(warning, WarningOut)) for warning in job.result_warnings),
            links=JobLinks(
                self=address,
                session=f"/v1/sessions/{job.session_id}",
                attempts=f"{address}/attempts",
                events=f"{address}/events",
                results=f"{address}/results",
                results_zip=f"{address}/results.zip",
                cancel=f"{address}/cancel" if job.state in CANCELABLE else None,
                retry=f"{address}/retry" if is_worth_a_retry(job.state, job.problem) else None,
            ),
        )


class JobPage(_Answer):
    """Some jobs, the newest first."""

    jobs: tuple[JobOut, ...]
    next_cursor: str | None = Field(description="For the next page, if there may be one.")


class EndedJob(_Answer):
    """Which job has ended, and how; the rest is to be asked for."""

    id: Id
    session_id: Id
    state: JobState
    attempt: int
    warnings: tuple[str, ...] = Field(description="As in the job.")


class JobEnded(_Answer):
    """A webhook, by Standard Webhooks: `webhook-id`, `webhook-timestamp` and `webhook-signature` come with it."""

    type: str = Field(description="`job.` and the state.")
    timestamp: AwareDatetime
    data: EndedJob


class ResultOut(_Answer):
    """A result file."""

    name: str
    kind: str = Field(description="Such as `bvh`, `skeletons`, `metrics`.")
    person: str | None = Field(description="Of whom, if of one person.")
    media_type: str
    num_bytes: int
    sha256: str = Field(description="Also its strong ETag.")
    link: str

    @classmethod
    def of(cls, job_id: str, result: Result) -> Self:
        """Build the response from a result."""
        return cls(link=f"/v1/jobs/{job_id}/results/{result.name}", **_fields(result, cls, without=("link",)))


class ResultList(_Answer):
    """All result files of a job."""

    results: tuple[ResultOut, ...]


class QuotaOut(_Answer):
    """How much a tenant has of something."""

    used: int
    limit: int | None = Field(description="How much it may have; null: as much as there is room for.")


class QuotasOut(_Answer):
    """How much a tenant has, and may have."""

    sessions: QuotaOut
    unfinished_jobs: QuotaOut
    stored_bytes: QuotaOut = Field(
        description="Of its sessions' files, with all that came of them; uploads count by what they are to be."
    )
    uploads: QuotaOut = Field(description="That are no session's yet.")

    @classmethod
    def of(cls, usage: Usage, quotas: Quotas) -> Self:
        """Build the response from the usage and the quotas of a tenant."""
        return cls(
            **{name: QuotaOut(used=getattr(usage, name), limit=getattr(quotas, name)) for name in cls.model_fields}
        )


class CallerOut(_Answer):
    """Who calls."""

    tenant: str = Field(description="Whose sessions and jobs the caller sees.")
    name: str | None = Field(
        description="The key's; null as long as there are no keys, and everybody may do everything."
    )
    scopes: tuple[Scope, ...]
    expires_at: AwareDatetime | None = Field(description="When the key ends.")
    quotas: QuotasOut


class BrowserSession(BaseModel):
    """What a browser shows to be let in."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    key: str = Field(max_length=200, description="A key, `mc_...`.")


class Health(_Answer):
    """The process is alive."""

    status: str = "ok"


class DetectorOut(_Answer):
    """A detector."""

    name: str = Field(description="As `detector` of a job.")
    installed: bool | None = Field(description="Whether a worker has it; null while no worker is ready.")
    install: str = Field(description="What the operator does to install it.")


class ValueOut(_Answer):
    """A named value of a choice."""

    name: str = Field(description="As in the spec of a job.")
    label: str = Field(description="For people.")


class ChoiceOut(_Answer):
    """A choice of a job: what a form needs to ask for it."""

    name: str = Field(description="Name of the field in the spec of a job.")
    label: str = Field(description="Heading of the field in a form.")
    description: str
    kind: Kind = Field(
        description="`one` of the values, a list of `several` of them, a `number`, a `whole_number`, or a "
        "`frame_range`: a list of two whole numbers."
    )
    values: tuple[ValueOut, ...] = Field(description="Named values; of numbers, names that stand for no number.")
    default: str | float | tuple[str, ...] | None
    unset: str | None = Field(description="Meaning of null, where that is the default.")
    minimum: float | None
    exclusive_minimum: float | None
    maximum: float | None

    @classmethod
    def of(cls, choice: Choice) -> Self:
        """Build the response from a choice."""
        about = choice.about
        return cls(
            name=choice.name,
            label=about.label,
            description=about.sentence,
            kind=choice.kind,
            values=tuple(ValueOut(name=name, label=value.label) for name, value in choice.values.items()),
            default=choice.default,
            unset=about.unset,
            minimum=about.minimum,
            exclusive_minimum=about.above,
            maximum=about.maximum,
        )


class Options(_Answer):
    """Choices of jobs, and what is installed."""

    detectors: tuple[DetectorOut, ...] = Field(description="All that the service knows.")
    choices: tuple[ChoiceOut, ...] = Field(description="All choices of a job, for a form; `callback_url` is none.")


class Readiness(_Answer):
    """A worker could start a job's work now."""

    status: str = "ready"
    checks: dict[str, bool]
    disk_free_bytes: int = Field(description="Room on the disk of the data folder.")


def _fields(record: object, wire: type[BaseModel], without: tuple[str, ...] = ()) -> dict[str, Any]:
    """Fields of a record that have the same name on the wire."""
    return {name: getattr(record, name) for name in wire.model_fields if name not in without}
