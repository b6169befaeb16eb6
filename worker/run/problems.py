"""Problems of jobs made from exceptions: sentences for the client, and whether another attempt may succeed."""

from pipeline.core.errors import ChildError, InputError, ModelError, PipelineError, Problem, SessionRefused, listed
from pipeline.core.problems.code_group import Code
from pipeline.core.problems.finding_codes import MEMORY_LIMIT, TIME_LIMIT
from pipeline.core.problems.request_codes import ARTIFACTS_REFUSED, INTERNAL_ERROR, STORAGE_FULL
from worker.store.errors import ArtifactsRefused
from worker.store.files.disk import is_disk_full
from worker.store.model.job_records import JobProblem, SessionError
from worker.store.outages import Outage

_NAMES = {Outage.DATABASE: "database", Outage.ARTIFACTS: "artifact store", Outage.BROKER: "broker"}


def waiting_for(outage: Outage, stage: str | None = None) -> JobProblem:
    """Build what a job waits for during an outage."""
    return JobProblem(
        Code(outage),
        f"The {_NAMES[outage]} does not respond; the job waits for it.",
        stage=stage,
        hint="Nothing has to be done: the job continues by itself, and no attempt is lost.",
        retryable=True,
    )


def too_long(stage: str) -> JobProblem:
    """Build the problem of a chunk that was stopped because it took many times its foreseen time."""
    return JobProblem(
        TIME_LIMIT,
        f"A chunk of the stage {stage} took many times as long as foreseen, and was stopped.",
        stage=stage,
        hint="Retry the job. If it fails again, the workers' logs show where it hung; on slow machines the operator "
        "raises MULTICAP_CHUNK_TIME_FACTOR.",
        retryable=True,
    )


def job_problem(error: Exception, stage: str) -> JobProblem:
    """Build the problem of a chunk that failed with an exception; with the errors of a session that was refused."""
    return _refusal(error, stage) if isinstance(error, SessionRefused) else _failure(error, stage)


def _refusal(error: SessionRefused, stage: str) -> JobProblem:
    problems = listed(error.problems)
    return JobProblem(
        error.code,
        " ".join(_sentence(problem) for problem in problems),
        stage=stage,
        hint=error.advice,
        errors=tuple(SessionError(problem.code, problem.message, problem.camera, problem.hint) for problem in problems),
    )


def _failure(error: Exception, stage: str) -> JobProblem:
    """Build the problem of a chunk that failed with an exception.

    Errors of the pipeline keep their messages, which are written for people. They are retryable unless the input causes
    them. Other exceptions become a sentence without their text, which may contain paths; the text goes to the log.
    """
    match error:
        case InputError(problems=(only,)):
            message = f"{only.file}: {only.message}" if only.file else only.message
            return JobProblem(only.code, message, stage=stage, camera=only.camera, hint=only.hint)
        case InputError() | PipelineError():
            # A model may be installed or memory freed before the next attempt; the input stays the same.
            return JobProblem(error.code, str(error), stage=stage, retryable=isinstance(error, ModelError | ChildError))
        case MemoryError():
            return JobProblem(
                MEMORY_LIMIT,
                f"The stage {stage} needs more memory than the service allows a worker.",
                stage=stage,
                hint="Use fewer frames of the capture, or ask the operator to raise MULTICAP_MEMORY_BYTES.",
            )
        case ArtifactsRefused():
            return JobProblem(
                ARTIFACTS_REFUSED,
                f"The artifact store refused the service at the stage {stage}.",
                stage=stage,
                hint="The operator checks MULTICAP_ARTIFACTS_URL, its bucket and its keys; then retry the job.",
                retryable=True,
            )
        case _ if is_disk_full(error):
            return JobProblem(
                STORAGE_FULL,
                f"The service's disk is full; the stage {stage} could not store its output.",
                stage=stage,
                hint="Free space on the disk, then retry the job: finished chunks are not run again.",
                retryable=True,
            )
        case _:
            return JobProblem(
                INTERNAL_ERROR,
                f"The stage {stage} failed inside the service.",
                stage=stage,
                hint="Retry the job. If it fails again, the worker's log says why.",
                retryable=True,
            )


def _sentence(problem: Problem) -> str:
    """Message of an error of a session, with its camera."""
    return f"{problem.camera}: {problem.message}" if problem.camera else problem.message
