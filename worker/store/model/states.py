"""States of jobs, attempts, files and chunks, and their legal transitions; ARCHITECTURE.md draws them."""

from collections.abc import Mapping
from enum import StrEnum


class JobState(StrEnum):
    """State of a job."""

    QUEUED = "queued"
    RUNNING = "running"
    CANCELING = "canceling"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELED = "canceled"
    EXPIRED = "expired"


class FilesState(StrEnum):
    """State of the files of a job that has succeeded."""

    CURRENT = "current"  # They show the present edits
    UPDATING = "updating"  # They show earlier edits; newer files are being made
    FAILED = "failed"  # They show earlier edits; newer files could not be made, or were canceled


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
REMAKABLE = frozenset(JobState) - {JobState.EXPIRED}
"""States of jobs whose files can be made again, if people have been found."""
CANCELABLE = frozenset({JobState.QUEUED, JobState.RUNNING})
AT_WORK = (JobState.QUEUED, JobState.RUNNING)
"""States of jobs that have chunks to claim."""
UNFINISHED = (*AT_WORK, JobState.CANCELING)
"""States of jobs that have not ended; few jobs are in them."""
FINISHED = frozenset({JobState.SUCCEEDED, JobState.FAILED, JobState.CANCELED, JobState.EXPIRED})


def job_state(attempt_state: JobState, has_files: bool) -> JobState:
    """State of a job: the state of its attempt, but a job that has files has succeeded until it expires."""
    return JobState.SUCCEEDED if has_files and attempt_state is not JobState.EXPIRED else attempt_state


def files_state(attempt_state: JobState, has_files: bool) -> FilesState | None:
    """State of the files of a job; ``None`` before it has succeeded, and once it is expired."""
    if not has_files or attempt_state is JobState.EXPIRED:
        return None
    if attempt_state is JobState.SUCCEEDED:
        return FilesState.CURRENT
    return FilesState.UPDATING if attempt_state in UNFINISHED else FilesState.FAILED
