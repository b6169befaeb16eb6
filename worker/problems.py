"""An exception in the words of a job's problem: what the client may know, and whether another try makes sense."""

from pipeline.errors import ChildError, InputError, ModelError, PipelineError
from worker.jobs.files.disk import is_disk_full
from worker.jobs.model import Problem


def problem_of(error: Exception, stage: str) -> Problem:
    """Say what went wrong with a chunk.

    Errors of the pipeline keep their words, which are made for people; another try makes sense unless the input causes
    them. All others become one sentence without their text, which may hold paths; it belongs in the log.
    """
    match error:
        case InputError(problems=(only,)):
            words = f"{only.file}: {only.message}" if only.file else only.message
            return Problem(only.code, words, stage=stage, camera=only.camera, hint=only.hint)
        case InputError() | PipelineError():
            # Models are installed, and memory is freed, while the input stays as it is.
            return Problem(error.code, str(error), stage=stage, retryable=isinstance(error, ModelError | ChildError))
        case MemoryError():
            return Problem(
                "memory_limit",
                f"The stage {stage} needs more memory than the service allows a worker.",
                stage=stage,
                hint="Use fewer frames of the session, or have the operator raise MULTICAP_MEMORY_BYTES.",
            )
        case _ if is_disk_full(error):
            return Problem(
                "storage_full",
                f"The service's disk is full; the stage {stage} could not keep its output.",
                stage=stage,
                hint="Make room on it, then retry the job: what was finished is not done again.",
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
