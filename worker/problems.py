"""Problems of jobs made from exceptions: sentences for the client, and whether another attempt may succeed."""

from pipeline.errors import ChildError, InputError, ModelError, PipelineError
from worker.jobs.files.disk import is_disk_full
from worker.jobs.model import Problem


def problem_of(error: Exception, stage: str) -> Problem:
    """Build the problem of a chunk that failed with an exception.

    Errors of the pipeline keep their messages, which are written for people. They are retryable unless the input causes
    them. Other exceptions become a sentence without their text, which may contain paths; the text goes to the log.
    """
    match error:
        case InputError(problems=(only,)):
            message = f"{only.file}: {only.message}" if only.file else only.message
            return Problem(only.code, message, stage=stage, camera=only.camera, hint=only.hint)
        case InputError() | PipelineError():
            # A model may be installed or memory freed before the next attempt; the input stays the same.
            return Problem(error.code, str(error), stage=stage, retryable=isinstance(error, ModelError | ChildError))
        case MemoryError():
            return Problem(
                "memory_limit",
                f"The stage {stage} needs more memory than the service allows a worker.",
                stage=stage,
                hint="Use fewer frames of the session, or ask the operator to raise MULTICAP_MEMORY_BYTES.",
            )
        case _ if is_disk_full(error):
            return Problem(
                "storage_full",
                f"The service's disk is full; the stage {stage} could not store its output.",
                stage=stage,
                hint="Free space on the disk, then retry the job: finished chunks are not run again.",
                retryable=True,
            )
        case _:
            return Problem(
                "internal_error",
                f"The stage {stage} failed inside the service.",
                stage=stage,
                hint="Retry the job. If it fails again, the worker's log says why.",
                retryable=True,
            )
