"""Bodies of jobs: the envelope that every answer, event and webhook has, with stages, attempts and results."""

from typing import Literal, Self

from pydantic import AwareDatetime, Field

from api.web.contract.schemas import ID, TIME, FindingOut, Id, NextCursor, ResponseModel, SpaceOut
from pipeline.core.options.providers import ProviderName, provider_name
from pipeline.core.problems.code_group import Code
from pipeline.run.engine.plan import STAGE_BY_NAME
from pipeline.run.engine.stage import DETECT
from worker.store.model import job_records
from worker.store.model.states import CANCELABLE, RETRYABLE, ChunkState, FilesState, JobState
from worker.store.spec import JobSpec


class StageOut(ResponseModel):
    """Stage of a job with its progress."""

    name: str = Field(description="Name of the stage, such as `detect`.", examples=[DETECT])
    label: str = Field(description="Name of the stage for people.", examples=["Finding people"])
    state: ChunkState = Field(description="State of the stage.", examples=["done"])
    done: int = Field(description="Units of work that are done, such as a camera's frames.", examples=[600])
    total: int = Field(description="All units of work.", examples=[600])
    unit: Literal["frames", "steps"] = Field(description="Unit of `done` and `total`.")
    fraction: float = Field(ge=0, le=1, description="Share of the units that are done.")
    started_at: AwareDatetime | None = Field(description="Start of the first chunk; null before.", examples=[TIME])
    finished_at: AwareDatetime | None = Field(description="End of the last chunk; null before.", examples=[TIME])
    reused: bool = Field(description="Whether the outputs of an earlier job were used.")

    @classmethod
    def from_stage(cls, stage: job_records.StageProgress) -> Self:
        """Build the response from a stage."""
        fraction = stage.done / stage.total if stage.total else float(stage.state is ChunkState.DONE)
        declared = STAGE_BY_NAME[stage.name]
        return cls.from_record(stage, label=declared.label, unit=declared.unit, fraction=min(1.0, fraction))


class SessionErrorOut(ResponseModel):
    """Error that a check of a job's session found."""

    code: Code = Field(description="Stable code; `/help/problems` lists all codes.")
    message: str = Field(description="Description of the error, a sentence for a person.")
    camera: str | None = Field(description="Camera that the error is about; null if it is not about one.")
    hint: str | None = Field(description="Advice to the caller.")
    file: str | None = Field(default=None, description="Name of the file that the error is about.")


class JobError(ResponseModel):
    """Error of a job or of an attempt at a chunk."""

    code: Code = Field(description="Stable code; `/help/problems` lists all codes.", examples=["worker_lost"])
    detail: str = Field(examples=["A worker stopped responding."])
    """Description of the error, a sentence for a person."""
    stage: str | None = Field(description="Stage that failed.", examples=[DETECT])
    camera: str | None = Field(description="Camera whose file caused the error.")
    hint: str | None = Field(description="Advice to the caller.", examples=["It may lack memory."])
    retryable: bool = Field(description="Whether another attempt may succeed.", examples=[True])
    errors: tuple[SessionErrorOut, ...] = ()
    """Errors of the session with `session_unusable`, or `session_refused`: with `force` another job reconstructs it all
    the same."""


class FailureOut(ResponseModel):
    """Failed attempt at a chunk of a stage."""

    stage: str = Field(description="Name of the stage.", examples=[DETECT])
    chunk: int = Field(description="Number of the chunk in its stage, from 0.")
    chunk_try: int = Field(description="Number of the attempt at the chunk, from 1.")
    failed_at: AwareDatetime = Field(description="Time of the failure.")
    reason: JobError = Field(description="Error of the attempt.")

    @classmethod
    def from_failure(cls, failure: job_records.Failure) -> Self:
        """Build the response from a failure."""
        return cls.from_record(failure, chunk=failure.chunk_index, reason=failure.problem)


class AttemptOut(ResponseModel):
    """Attempt of a job: its first run, or a retry."""

    attempt: int = Field(description="Number of the attempt, from 1.")
    state: JobState = Field(description="State of the job in this attempt.", examples=["running"])
    queued_at: AwareDatetime = Field(description="Time at which the attempt was queued.")
    started_at: AwareDatetime | None = Field(examples=[TIME])
    """Start of the attempt; null while it is queued."""
    finished_at: AwareDatetime | None = Field(description="End of the attempt; null before.")
    error: JobError | None = Field(description="Error that ended the attempt; null if it did not fail.")
    failures: tuple[FailureOut, ...] = Field(description="Failed attempts at chunks, in the order of time.")

    @classmethod
    def from_attempt(cls, attempt: job_records.Attempt) -> Self:
        """Build the response from an attempt."""
        failures = tuple(map(FailureOut.from_failure, attempt.failures))
        return cls.from_record(attempt, error=attempt.problem, failures=failures)


class AttemptList(ResponseModel):
    """All attempts of a job, in the order of time."""

    attempts: tuple[AttemptOut, ...]


class JobUrls(ResponseModel):
    """Paths of a job and of everything that belongs to it."""

    self: str = Field(description="Path of the job.", examples=[f"/v1/jobs/{ID}"])
    session: str = Field(description="Path of the job's session.", examples=[f"/v1/sessions/{ID}"])
    attempts: str = Field(description="Path of the job's attempts.", examples=[f"/v1/jobs/{ID}/attempts"])
    events: str = Field(description="Path of the job's event stream.", examples=[f"/v1/jobs/{ID}/events"])
    results: str = Field(description="Path of the list of result files.", examples=[f"/v1/jobs/{ID}/results"])
    results_zip: str = Field(examples=[f"/v1/jobs/{ID}/results.zip"])
    """Path of the archive of all result files."""
    edits: str | None = Field(examples=[f"/v1/sessions/{ID}/edits?job_id={ID}"])
    """Path of the capture's edits in this run; null until people are found."""
    files: str | None = Field(examples=[f"/v1/jobs/{ID}/files"])
    """Path that adds files, and applies the capture's present edits; null until people are found."""
    cancel: str | None
    """Path that cancels the job, or the update of its files; null once nothing is at work."""
    visuals: str | None
    """Path that makes overlay videos, report and recording again; null unless they are of earlier edits than the other
    files, and no job makes them; of overlay videos also if the session's videos were deleted."""
    retry: str | None
    """Path that retries the job, or the update of its files; null unless it was canceled, or failed with a retryable
    error."""


class VisualsJobOut(ResponseModel):
    """Job that makes overlay videos, the report, the recording and blurred videos for files that were made again."""

    id: Id
    state: JobState = Field(description="State of that job.")


class JobOut(ResponseModel):
    """Job: a reconstruction of a session, or the making of a calibration, of proxies of its videos, or of visuals.

    Visuals are the overlay videos, the report and the recording of an edited job.
    """

    id: Id
    kind: job_records.JobKind = Field(description="What the job makes.")
    calibration_id: Id | None = Field(description="Calibration that the job makes; null of others.")
    session_id: Id
    session_name: str = Field(description="Name of the session.", examples=["Handshake, take 3"])
    num_frames: int = Field(examples=[300])
    """Output frames of the whole session; `spec.frame_range` may select some."""
    duration_s: float = Field(examples=[12.0])
    """Duration of the session: output frames divided by the frame rate."""
    state: JobState = Field(description="State of the job.", examples=["succeeded"])
    files_state: FilesState | None = Field(examples=["current"])
    """State of the files: `current`; `updating`, they are made again after an edit or with more formats; `failed`, they
    could not be made again. Meanwhile the earlier files can be read. Null unless `state` is `succeeded`."""
    spec: JobSpec = Field(description="Choices of the job.", examples=[JobSpec().model_dump(mode="json")])
    attempt: int = Field(description="Number of the current attempt, from 1.")
    revision: int = Field(description="Number of times that the job's files were made again.", examples=[0])
    edits_revision: int | None = Field(examples=[0])
    """Revision of the capture's edits that the files of `revision` apply; null if they are left out."""
    newest_edits_revision: int = Field(examples=[0])
    """Present revision of the capture's edits; a later one than `edits_revision` has more edits."""
    results_revision: int | None = Field(examples=[0])
    """Revision whose result files can be read, also while the files of `revision` are made; null before the first files
    are."""
    visuals_job: VisualsJobOut | None
    """Job that makes the visuals of these edits; null without one."""
    provider: ProviderName | None = Field(examples=["cpu"])
    """Execution provider that its networks run on, such as `cuda`; null if it runs none."""
    stages: tuple[StageOut, ...] = Field(description="Stages of the job, in order.")
    progress: float = Field(ge=0, le=1)
    """Share of the work that is done; it never decreases within an attempt."""
    queue_position: int | None = Field(description="Position in the queue, from 1; null once the job runs.")
    eta_s: float | None = Field(ge=0)
    """Estimated seconds left, from the work that is done; null before any work is done, and at the end."""
    created_at: AwareDatetime = Field(description="Time of the creation.")
    started_at: AwareDatetime | None = Field(examples=[TIME])
    """Start of the current attempt; null while it is queued."""
    finished_at: AwareDatetime | None = Field(description="End of the current attempt; null before.", examples=[TIME])
    expires_at: AwareDatetime | None
    """Time at which results are deleted; null if they are kept until the job is deleted."""
    error: JobError | None
    """Error that ended the job, or the update of its files; null if it did not fail."""
    waiting_for: JobError | None
    """Cause of the wait: an outage such as `artifacts_unavailable`, or `videos_fetching`. The job continues by
    itself, and no attempt is lost. Null if nothing keeps it waiting."""
    warnings: tuple[FindingOut, ...]
    """Warnings about the files, the choices and, once finished, the result, such as `nobody_found`."""
    space: SpaceOut | None = None
    """Space that the reconstruction was foreseen to need before it started; null of other jobs."""
    urls: JobUrls

    @classmethod
    def from_job(cls, job: job_records.JobRecord) -> Self:
        """Build the response from a job."""
        address = f"/v1/jobs/{job.id}"
        runs_networks = any(STAGE_BY_NAME[stage.name].runs_networks for stage in job.stages)
        return cls.from_record(
            job,
            kind=job_records.job_kind(job.making),
            calibration_id=job.id if job_records.job_kind(job.making) == "calibration" else None,
            provider=provider_name(job.provider) if runs_networks else None,
            stages=tuple(map(StageOut.from_stage, job.stages)),
            error=job.problem,
            urls=JobUrls(
                self=address,
                session=f"/v1/sessions/{job.session_id}",
                attempts=f"{address}/attempts",
                events=f"{address}/events",
                results=f"{address}/results",
                results_zip=f"{address}/results.zip",
                edits=f"/v1/sessions/{job.session_id}/edits?job_id={job.id}" if job.has_people else None,
                files=f"{address}/files" if job.has_people else None,
                cancel=f"{address}/cancel" if job.attempt_state in CANCELABLE else None,
                visuals=f"{address}/visuals" if _may_make_visuals(job) else None,
                retry=f"{address}/retry" if job_records.is_worth_a_retry(job.attempt_state, job.problem) else None,
            ),
        )

    def for_link(self) -> Self:
        """Job as a link shows it: without the receiver of its webhooks, and without what may be done with it."""
        urls = self.urls.model_copy(
            update={"edits": None, "files": None, "cancel": None, "visuals": None, "retry": None}
        )
        return self.model_copy(update={"spec": self.spec.model_copy(update={"callback_url": None}), "urls": urls})


def _may_make_visuals(job: job_records.JobRecord) -> bool:
    """True if a request rebuilds the visuals of a job."""
    has_failed = job.visuals_job is not None and job.visuals_job.state in RETRYABLE
    can_make = job.has_videos or not (job.spec.overlay or "rerun" in job.spec.exports)
    return job.files_state is FilesState.CURRENT and can_make and (job.has_old_visuals or has_failed)


class JobPage(ResponseModel):
    """Page of jobs, the newest job first."""

    jobs: tuple[JobOut, ...]
    next_cursor: NextCursor


class EndedJob(ResponseModel):
    """Job that has ended, or whose files have, in short; `GET /v1/jobs/{id}` has all fields."""

    id: Id
    session_id: Id
    state: JobState = Field(description="State of the job at its end.", examples=["succeeded"])
    files_state: FilesState | None = Field(description="State of its files; null unless it has succeeded.")
    attempt: int = Field(description="Number of the attempt that ended.")
    warnings: tuple[FindingOut, ...] = Field(description="Warnings of the job.")


class JobEnded(ResponseModel):
    """Webhook about the end of a job, or of an update of its files, by Standard Webhooks.

    Its headers are `webhook-id`, `webhook-timestamp` and `webhook-signature`.
    """

    type: str = Field(examples=["job.succeeded"])
    """Type of the message: `job.` and the state of the job; after an edit `job.files_current` or `job.files_failed`."""
    timestamp: AwareDatetime = Field(description="Time of the end.")
    data: EndedJob
