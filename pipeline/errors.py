"""Errors that the input causes: a retry would fail the same way.

::

    PipelineError            a clear sentence, a stable ``code``
    ├── InputError           bad input: every problem found, at once
    └── ModelError           a detector network or the sample capture can't be installed or used
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong with the input, and what to do about it.

    Parameters
    ----------
    code
        Stable and documented, such as ``video_truncated``.
    message
        One sentence for a person. Names a file by its base name, never by its path.
    file, camera, field
        Where it is: a file's base name, a camera's name, a field such as ``matrix``; ``None`` where it does not apply.
    hint
        What to do.
    """

    code: str
    message: str
    file: str | None = None
    camera: str | None = None
    field: str | None = None
    hint: str | None = None

    def __str__(self) -> str:
        where = ", ".join(
            f"{kind} {value}"
            for kind, value in (("file", self.file), ("camera", self.camera), ("field", self.field))
            if value
        )
        text = f"{where}: {self.message}" if where else self.message
        return f"{text} {self.hint}" if self.hint else text


class PipelineError(Exception):
    """Base of errors that the input causes: a retry would fail the same way."""

    code: ClassVar[str] = "pipeline_error"


class InputError(PipelineError):
    """The input is unusable; ``problems`` holds everything that is wrong with it, never the first thing only."""

    code: ClassVar[str] = "input_error"

    def __init__(self, problems: Sequence[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems))


class ModelError(PipelineError):
    """A detector network or the sample capture can't be installed or used."""

    code: ClassVar[str] = "model_error"
