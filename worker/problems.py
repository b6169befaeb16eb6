"""An exception in the words of a job's problem: what the client may know, and whether another try makes sense."""

from pipeline.errors import InputError, PipelineError
from worker.jobs.model import Problem


def problem_of(error: Exception, stage: str) -> Problem:
    """Say what went wrong with a chunk.

    Errors that the input causes keep their words, which are made for people. All others become one sentence without
    their text, which may hold paths; it belongs in the log.
    """
    match error:
        case InputError(problems=(only,)):
            words = f"{only.file}: {only.message}" if only.file else only.message
            return Problem(only.code, words, stage=stage, camera=only.camera, hint=only.hint)
        case InputError() | PipelineError():
            return Problem(error.code, str(error), stage=stage)
        case _:
            return Problem(
                "internal_error",
                f"The stage {stage} failed inside the service.",
                stage=stage,
                hint="Retry the job. If it fails again, the worker's log says why.",
                retryable=True,
            )
