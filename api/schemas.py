"""Bodies of requests and responses as Pydantic models; the stored records are in ``worker.jobs.model``."""

import json
import unicodedata
from collections.abc import Iterable
from typing import Annotated, Any, Literal, Self
from uuid import UUID

from pydantic import AfterValidator, AwareDatetime, BaseModel, ConfigDict, Field
from pydantic_core import PydanticCustomError

from pipeline.config import Choice, JointsOfBody, Kind, Profile
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
NextCursor = Annotated[str | None, Field(description="Cursor of the next page; null on the last page.")]


def printable_name(text: str) -> str:
    """Refuse control characters in a name."""
    if any(unicodedata.category(character).startswith("C") for character in text):
        raise PydanticCustomError("control_characters", "Control characters are not allowed.")
    return text


def _json(value: dict[str, Any]) -> dict[str, Any]:
    """Refuse values that Python's parser accepts and JSON does not allow, such as NaN and lone surrogates."""
    try:
        json.dumps(value, allow_nan=False, ensure_ascii=False).encode()
    except ValueError:
        message = "metadata must be valid JSON: no NaN, no infinity, no lone surrogates."
        raise PydanticCustomError("json_value", message) from None
    return value


class ResponseModel(BaseModel):
    """Base of the bodies of responses."""

    model_config = ConfigDict(json_schema_serialization_defaults_required=True)


class CameraManifest(BaseModel):
    """Facts about a camera's video that neither the file nor the calibration states."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Annotated[str, AfterValidator(printable_name)] = Field(
        min_length=1, max_length=64, description="Name of the camera in the calibration."
    )
    file: Annotated[str, AfterValidator(printable_name)] | None = Field(
        default=None,
        min_length=1,
        max_length=200,
        description="Name of the camera's video; by default the video with the camera's name.",
    )
    offset_s: float = Field(
        default=0.0,
        strict=True,
        ge=-86_400.0,
        le=86_400.0,
        allow_inf_nan=False,
        description="Time of the first frame on the clock that all cameras share.",
    )
    rate: float | None = Field(
        default=None,
        strict=True,
        ge=1.0,
        le=1000.0,
        allow_inf_nan=False,
        description="Frame rate in Hz, if the times in the video are wrong.",
    )


class Manifest(BaseModel):
    """Description of a session beside its files. Unknown fields are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Annotated[str, AfterValidator(printable_name)] = Field(
        default="untitled", min_length=1, max_length=200, description="Name of the session for people."
    )
    frame_rate_hz: float | None = Field(
        default=None,
        strict=True,
        ge=1.0,
        le=1000.0,
        allow_inf_nan=False,
        description="Frame rate of keypoints without timestamps; by default 25 Hz.",
    )
    cameras: tuple[CameraManifest, ...] = Field(
        default=(), max_length=256, description="Facts about some cameras of a session of videos."
    )
    units: Literal["m", "cm", "mm"] = Field(
        default="m",
        description="Unit of length of a calibration whose format does not state it (TOML, and JSON with K, R, t).",
    )
    metadata: Annotated[dict[str, Any], AfterValidator(_json)] = Field(
        default={}, description="Data of the client, which every response with the session repeats."
    )


class UploadedFiles(BaseModel):
    """Files that are sent as uploads, each given by the id of its upload. Unknown fields are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    videos: tuple[UUID, ...] = Field(default=(), description="Uploads of the videos, one for each camera.")

    def uploads(self) -> list[tuple[str, UUID]]:
        """Part of the form and id of each upload."""
        return [("videos", one) for one in self.videos]

    def named(self) -> Iterable[str]:
        """Names of the form's documents that the fields stand for."""
        return ()

    def upload_ids(self) -> tuple[str, ...]:
        """Ids of all uploads."""
        return tuple(sorted({str(upload_id) for _, upload_id in self.uploads()}))


class UploadedSession(UploadedFiles):
    """Session of uploaded files, each given by the id of its upload. Unknown fields are refused."""

    keypoints: tuple[UUID, ...] = Field(
        default=(),
        description="Uploads of keypoints in place of videos: for each camera a zip of OpenPose's JSON files, named as "
        "the camera.",
    )
    calibration: UUID | None = Field(default=None, description="Upload of the calibration of all cameras.")
    calibration_id: UUID | None = Field(
        default=None, description="Id of a stored calibration, in place of `calibration`."
    )
    timestamps: UUID | None = Field(
        default=None,
        description="Upload of the timestamps of keypoints: CSV with the columns camera, frame and time_s.",
    )
    manifest: Manifest = Manifest()

    def uploads(self) -> list[tuple[str, UUID]]:
        """Part of the form and id of each upload."""
        single = (("calibration", self.calibration), ("timestamps", self.timestamps))
        keypoints = [("keypoints", one) for one in self.keypoints]
        return [*super().uploads(), *keypoints, *((part, one) for part, one in single if one is not None)]

    def named(self) -> Iterable[str]:
        """Names of the form's documents that the fields stand for."""
        return () if self.calibration_id is None else ("calibration_id",)


class UploadedCapture(UploadedSession):
    """Session of uploaded files with the choices of its job. Unknown fields are refused."""

    spec: JobSpec = JobSpec()


class FileOut(ResponseModel):
    """File of a session."""

    name: str = Field(description="Name of the file.")
    kind: str = Field(description="Kind of the file: `video`, `keypoints`, `calibration` or `timestamps`.")
    num_bytes: int = Field(description="Size of the file.")
    sha256: str = Field(description="SHA-256 of the file in hexadecimal.")


class CameraOut(ResponseModel):
    """Camera of the calibration with its video or its keypoints."""

    name: str = Field(description="Name of the camera in the calibration.")
    file: str = Field(description="Name of the file with the camera's video or keypoints.")
    size_px: tuple[int, int] = Field(description="Width and height of the frames.")
    frame_rate_hz: float = Field(description="Frame rate of the video or the keypoints.")
    num_frames: int = Field(description="Number of frames in the file.")
    start_time_s: float = Field(default=0.0, description="Time of the camera's first frame on the session's clock.")


class TimebaseOut(ResponseModel):
    """Clock of the output frames: frame k is at ``start_time_s + k / frame_rate_hz``."""

    start_time_s: float = Field(description="Time of output frame 0.")
    frame_rate_hz: float = Field(description="Output frames a second.")
    num_frames: int = Field(description="Number of output frames.")


class PreflightOut(ResponseModel):
    """Result of the check of a session's files."""

    cameras: tuple[CameraOut, ...] = Field(description="Cameras of the session.")
    timebase: TimebaseOut = Field(description="Clock of the output frames.")
    warnings: tuple[str, ...] = Field(description="Warnings about the files.")


class SessionLinks(ResponseModel):
    """Paths of a session and of its jobs."""

    self: str = Field(description="Path of the session.")
    jobs: str = Field(description="Path of the session's jobs.")


class SessionOut(ResponseModel):
    """Capture session."""

    id: Id
    name: str = Field(description="Name of the session for people.")
    created_at: AwareDatetime = Field(description="Time of the creation.")
    files: tuple[FileOut, ...] = Field(description="Files of the session.")
    num_bytes: int = Field(description="Size of all files.")
    preflight: PreflightOut = Field(description="Result of the check of the files.")
    metadata: dict[str, Any] = Field(description="Metadata of the manifest.")
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


class SessionPage(ResponseModel):
    """Page of sessions, the newest session first."""

    sessions: tuple[SessionOut, ...]
    next_cursor: NextCursor


class StageOut(ResponseModel):
    """Stage of a job with its progress."""

    name: str = Field(description="Name of the stage, such as `detect`.")
    label: str = Field(description="Name of the stage for people.")
    state: ChunkState = Field(description="State of the stage.")
    done: int = Field(description="Units of work that are done, such as a camera's frames.")
    total: int = Field(description="All units of work.")
    fraction: float = Field(ge=0, le=1, description="Share of the units that are done.")
    started_at: AwareDatetime | None = Field(description="Start of the first chunk; null before.")
    finished_at: AwareDatetime | None = Field(description="End of the last chunk; null before.")
    reused: bool = Field(description="Whether the outputs of an earlier job were used.")

    @classmethod
    def of(cls, stage: Stage) -> Self:
        """Build the response from a stage."""
        fraction = stage.done / stage.total if stage.total else float(stage.state is ChunkState.DONE)
        label = STAGE_BY_NAME[stage.name].label
        return cls(label=label, fraction=min(1.0, fraction), **_fields(stage, cls, without=("label", "fraction")))


class JobError(ResponseModel):
    """Error of a job or of an attempt at a chunk."""

    code: str = Field(description="Stable code; docs/problems.md lists all codes.")
    detail: str = Field(description="Description of the error, a sentence for a person.")
    stage: str | None = Field(description="Stage that failed.")
    camera: str | None = Field(description="Camera whose file caused the error.")
    hint: str | None = Field(description="Advice to the caller.")
    retryable: bool = Field(description="Whether another attempt may succeed.")

    @classmethod
    def of(cls, problem: Problem) -> Self:
        """Build the response from a problem."""
        return cls(**_fields(problem, cls))


class FailureOut(ResponseModel):
    """Failed attempt at a chunk of a stage."""

    stage: str = Field(description="Name of the stage.")
    chunk: int = Field(description="Number of the chunk in its stage, from 0.")
    chunk_try: int = Field(description="Number of the attempt at the chunk, from 1.")
    failed_at: AwareDatetime = Field(description="Time of the failure.")
    reason: JobError = Field(description="Error of the attempt.")

    @classmethod
    def of(cls, failure: Failure) -> Self:
        """Build the response from a failure."""
        return cls(
            chunk=failure.chunk_index,
            reason=JobError.of(failure.problem),
            **_fields(failure, cls, without=("chunk", "reason")),
        )


class AttemptOut(ResponseModel):
    """Attempt of a job: its first run, or a retry."""

    attempt: int = Field(description="Number of the attempt, from 1.")
    state: JobState = Field(description="State of the job in this attempt.")
    queued_at: AwareDatetime = Field(description="Time at which the attempt was queued.")
    started_at: AwareDatetime | None = Field(description="Start of the attempt; null while it is queued.")
    finished_at: AwareDatetime | None = Field(description="End of the attempt; null before.")
    error: JobError | None = Field(description="Error that ended the attempt; null if it did not fail.")
    failures: tuple[FailureOut, ...] = Field(description="Failed attempts at chunks, in the order of time.")

    @classmethod
    def of(cls, attempt: Attempt) -> Self:
        """Build the response from an attempt."""
        return cls(
            error=JobError.of(attempt.problem) if attempt.problem else None,
            failures=tuple(FailureOut.of(failure) for failure in attempt.failures),
            **_fields(attempt, cls, without=("error", "failures")),
        )


class AttemptList(ResponseModel):
    """All attempts of a job, in the order of time."""

    attempts: tuple[AttemptOut, ...]


class WarningOut(ResponseModel):
    """Warning about a result."""

    code: str = Field(description="Stable code, such as `few_views`; docs/problems.md lists all codes.")
    message: str = Field(description="Sentence for people.")


class JobLinks(ResponseModel):
    """Paths of a job and of everything that belongs to it."""

    self: str = Field(description="Path of the job.")
    session: str = Field(description="Path of the job's session.")
    attempts: str = Field(description="Path of the job's attempts.")
    events: str = Field(description="Path of the job's event stream.")
    results: str = Field(description="Path of the list of result files.")
    results_zip: str = Field(description="Path of the archive of all result files.")
    cancel: str | None = Field(description="Path that cancels the job; null once the job is canceled or finished.")
    retry: str | None = Field(
        description="Path that retries the job; null unless the job was canceled, or failed with a retryable error."
    )


class JobOut(ResponseModel):
    """Job: a reconstruction of a session, or the making of a calibration from it."""

    id: Id
    kind: Literal["reconstruction", "calibration"] = Field(description="What the job makes.")
    calibration_id: Id | None = Field(description="Calibration that the job makes; null of a reconstruction.")
    session_id: Id
    session_name: str = Field(description="Name of the session.")
    num_frames: int = Field(description="Output frames of the whole session; `spec.frame_range` may select some.")
    duration_s: float = Field(description="Duration of the session: output frames divided by the frame rate.")
    state: JobState = Field(description="State of the job.")
    spec: JobSpec = Field(description="Choices of the job.")
    attempt: int = Field(description="Number of the current attempt, from 1.")
    stages: tuple[StageOut, ...] = Field(description="Stages of the job, in order.")
    progress: float = Field(
        ge=0, le=1, description="Share of the work that is done; it never decreases within an attempt."
    )
    queue_position: int | None = Field(description="Position in the queue, from 1; null once the job runs.")
    eta_s: float | None = Field(
        ge=0,
        description="Estimated seconds left, from the work that is done; null before any work is done, and at the end.",
    )
    created_at: AwareDatetime = Field(description="Time of the creation.")
    started_at: AwareDatetime | None = Field(description="Start of the current attempt; null while it is queued.")
    finished_at: AwareDatetime | None = Field(description="End of the current attempt; null before.")
    expires_at: AwareDatetime | None = Field(
        description="Time at which results are deleted; null if they are kept until the job is deleted."
    )
    error: JobError | None = Field(description="Error that ended the job; null if it did not fail.")
    warnings: tuple[str, ...] = Field(
        description="Warnings about the files, the choices and, once finished, the result."
    )
    result_warnings: tuple[WarningOut, ...] = Field(
        description="Warnings about the result with codes, such as `nobody_found`; docs/problems.md lists all codes."
    )
    links: JobLinks

    @classmethod
    def of(cls, job: Job) -> Self:
        """Build the response from a job."""
        address = f"/v1/jobs/{job.id}"
        return cls(
            **_fields(job, cls, without=("kind", "calibration_id", "stages", "error", "result_warnings", "links")),
            kind="reconstruction" if job.making is None else "calibration",
            calibration_id=None if job.making is None else job.id,
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


class JobPage(ResponseModel):
    """Page of jobs, the newest job first."""

    jobs: tuple[JobOut, ...]
    next_cursor: NextCursor


class EndedJob(ResponseModel):
    """Job that has ended, in short; `GET /v1/jobs/{id}` has all fields."""

    id: Id
    session_id: Id
    state: JobState = Field(description="State of the job at its end.")
    attempt: int = Field(description="Number of the attempt that ended.")
    warnings: tuple[str, ...] = Field(description="Warnings of the job.")


class JobEnded(ResponseModel):
    """Webhook about the end of a job, by Standard Webhooks.

    Its headers are `webhook-id`, `webhook-timestamp` and `webhook-signature`.
    """

    type: str = Field(description="Type of the message: `job.` and the state of the job.")
    timestamp: AwareDatetime = Field(description="Time at which the job ended.")
    data: EndedJob


class ResultOut(ResponseModel):
    """Result file of a job."""

    name: str = Field(description="Name of the file.")
    kind: str = Field(description="Kind of the file, such as `bvh`, `skeletons`, `metrics`.")
    person: str | None = Field(description="Person in the file; null if it concerns all people.")
    media_type: str = Field(description="Content type of the file.")
    num_bytes: int = Field(description="Size of the file.")
    sha256: str = Field(description="SHA-256 of the file in hexadecimal; it is the file's strong ETag, too.")
    link: str = Field(description="Path of the file.")

    @classmethod
    def of(cls, job_id: str, result: Result) -> Self:
        """Build the response from a result."""
        return cls(link=f"/v1/jobs/{job_id}/results/{result.name}", **_fields(result, cls, without=("link",)))


class ResultList(ResponseModel):
    """All result files of a job."""

    results: tuple[ResultOut, ...]


class QuotaOut(ResponseModel):
    """Usage and limit of a quota."""

    used: int = Field(description="Present usage of the tenant.")
    limit: int | None = Field(description="Largest allowed usage; null without a limit.")


class QuotasOut(ResponseModel):
    """Quotas of a tenant."""

    sessions: QuotaOut = Field(description="Number of sessions.")
    unfinished_jobs: QuotaOut = Field(description="Number of jobs that wait or run.")
    stored_bytes: QuotaOut = Field(
        description="Size of all sessions with everything made from them; uploads count with their announced size."
    )
    uploads: QuotaOut = Field(description="Number of uploads that no session uses yet.")

    @classmethod
    def of(cls, usage: Usage, quotas: Quotas) -> Self:
        """Build the response from a tenant's usage and quotas."""
        return cls(
            **{name: QuotaOut(used=getattr(usage, name), limit=getattr(quotas, name)) for name in cls.model_fields}
        )


class CallerOut(ResponseModel):
    """Caller of a request: its tenant, key and quotas."""

    tenant: str = Field(description="Tenant whose sessions and jobs the caller sees.")
    name: str | None = Field(
        description="Name of the key; null for a service without keys, in which every caller has all scopes."
    )
    scopes: tuple[Scope, ...] = Field(description="Scopes of the key.")
    expires_at: AwareDatetime | None = Field(description="Time at which the key expires; null if it does not.")
    quotas: QuotasOut = Field(description="Usage and quotas of the tenant.")


class BrowserSession(BaseModel):
    """Key with which a browser signs in."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    key: str = Field(max_length=200, description="API key, `mc_...`.")


class Health(ResponseModel):
    """Liveness of the API process."""

    status: str = "ok"


class DetectorOut(ResponseModel):
    """Detector network that can be used alone, and whether it is installed."""

    name: str = Field(description="Value of `detector` in the spec of a job.")
    installed: bool | None = Field(
        description="Whether all ready workers have the detector; null while no worker is ready."
    )
    install: str = Field(description="Advice to the operator on the installation.")


class ProfileNetworksOut(ResponseModel):
    """Networks of a profile for some joints, and whether they are installed."""

    joints: JointsOfBody = Field(description="Value of `joints` in the spec of a job.")
    networks: tuple[str, ...] = Field(description="Names of the networks.")
    installed: bool | None = Field(
        description="Whether all ready workers have the networks; null while no worker is ready."
    )
    install: str = Field(description="Advice to the operator on the installation.")


class ProfileOut(ResponseModel):
    """Profile: networks that find the 2D joints."""

    name: Profile = Field(description="Value of `profile` in the spec of a job.")
    default_joints: JointsOfBody = Field(description="Joints of the profile, where `joints` is `auto`.")
    joints: tuple[ProfileNetworksOut, ...] = Field(description="Networks by joints.")


class ValueOut(ResponseModel):
    """Named value of a choice."""

    name: str = Field(description="Value in the spec of a job.")
    label: str = Field(description="Label of the value for people.")
    note: str = Field(description="Further sentence, such as a measured cost; empty for none.")


class ChoiceOut(ResponseModel):
    """Choice of a job, as a field of a form."""

    name: str = Field(description="Name of the field in the spec of a job.")
    label: str = Field(description="Heading of the field in a form.")
    description: str = Field(description="Meaning of the choice, a sentence for people.")
    kind: Kind = Field(
        description="`one` of the values, a list of `several` of them, a `number`, a `whole_number`, or a "
        "`frame_range`: a list of two whole numbers."
    )
    values: tuple[ValueOut, ...] = Field(
        description="Named values; for numbers, the names allowed in place of a number."
    )
    default: str | float | tuple[str, ...] | None = Field(description="Default value.")
    unset: str | None = Field(description="Meaning of null, if null is the default.")
    minimum: float | None = Field(description="Smallest number.")
    exclusive_minimum: float | None = Field(description="Number that the value must exceed.")
    maximum: float | None = Field(description="Largest number.")

    @classmethod
    def of(cls, choice: Choice) -> Self:
        """Build the response from a choice."""
        about = choice.about
        return cls(
            name=choice.name,
            label=about.label,
            description=about.sentence,
            kind=choice.kind,
            values=tuple(
                ValueOut(name=name, label=value.label, note=value.note) for name, value in choice.values.items()
            ),
            default=choice.default,
            unset=about.unset,
            minimum=about.minimum,
            exclusive_minimum=about.above,
            maximum=about.maximum,
        )


class Options(ResponseModel):
    """Choices of a job, profiles and detector networks."""

    profiles: tuple[ProfileOut, ...] = Field(description="All profiles, with their networks.")

    detectors: tuple[DetectorOut, ...] = Field(description="All detectors that the service supports.")
    choices: tuple[ChoiceOut, ...] = Field(
        description="All choices of a job, for a form. `callback_url` is not listed."
    )


class Readiness(ResponseModel):
    """Readiness of the service: a worker could start a job now."""

    status: str = "ready"
    checks: dict[str, bool] = Field(description="Passed checks by name.")
    disk_free_bytes: int = Field(description="Free bytes on the disk of the data folder.")


def _fields(record: object, model: type[BaseModel], without: tuple[str, ...] = ()) -> dict[str, Any]:
    """Values of a model's fields from the attributes of a record with the same names."""
    return {name: getattr(record, name) for name in model.model_fields if name not in without}
