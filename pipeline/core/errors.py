"""Error classes of the pipeline, and the problems of the input that they list.

::

    PipelineError            a clear sentence, a stable ``code``
    ├── InputError           bad input: every problem found, at once; a retry fails the same way
    │   └── SessionRefused   the check of a session found errors; it can be reconstructed all the same
    ├── ModelError           a detector network, the sample capture or the human body can't be installed or used
    └── ChildError           a process of Multicap's own failed; the input is not at fault
"""

import errno
import unicodedata
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, ClassVar

from pipeline.core.problems.code_group import Code
from pipeline.core.problems.finding_codes import CHILD_FAILED, INPUT_ERROR, MODEL_ERROR, PIPELINE_ERROR, SESSION_REFUSED
from pipeline.core.problems.request_codes import MORE_PROBLEMS

DISK_FULL = frozenset({errno.ENOSPC, errno.EDQUOT})
"""Numbers of ``OSError`` that mean a full disk; the input is not at fault."""
# Thousands of problems usually have a single cause, which the first problems show.
_MAX_LISTED = 60
_MAX_LISTED_ALIKE = 10
_MAX_TEXT = 1000
_MAX_NAMES = 8
_MAX_NAME_LENGTH = 40


@dataclass(frozen=True, slots=True)
class Problem:
    """One problem of the input, and how to correct it.

    Parameters
    ----------
    code
        Stable, documented code, such as ``video_truncated``.
    message
        Sentence for the user. Names a file by its base name, never by its path.
    file, camera, field
        Location of the problem: a file's base name, a camera's name, a field such as ``matrix``; ``None`` where it
        does not apply.
    hint
        Advice for the user; ``None`` if there is none.

    Examples
    --------
    >>> str(Problem("no_overlap", "The videos do not overlap.", camera="left", hint="Check the offsets."))
    'camera left: The videos do not overlap. Check the offsets.'
    """

    code: Code
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


class UnusableError(Exception):
    """A file can't be used: problem code, message and hint."""

    def __init__(self, code: Code, message: str, hint: str | None = None) -> None:
        super().__init__(code)
        self.code, self.message, self.hint = code, message, hint

    def problem(self, path: Path) -> Problem:
        """Build the problem, with the name of the file."""
        return Problem(self.code, self.message, file=path.name, hint=self.hint)


def listed(problems: Sequence[Problem]) -> tuple[Problem, ...]:
    """Select the first 60 problems and make their text printable; a last problem counts the rest.

    At most ten problems with the same code, file and camera are selected.
    """
    alike: Counter[tuple[str, str | None, str | None]] = Counter()
    shown: list[Problem] = []
    for problem in problems:
        alike[kind := (problem.code, problem.file, problem.camera)] += 1
        if alike[kind] <= _MAX_LISTED_ALIKE and len(shown) < _MAX_LISTED:
            shown.append(problem)
    if more := len(problems) - len(shown):
        message = f"{more:,} more problems are not listed."
        shown.append(Problem(MORE_PROBLEMS, message, hint="Correct these first."))
    return tuple(_printable_problem(problem) for problem in shown)


def listed_names(names: Sequence[object]) -> str:
    """List some names of an untrusted file in a sentence, and the number of the others.

    >>> listed_names(["a", "b"])
    'a, b'
    """
    shown = [printable(str(name)[:_MAX_NAME_LENGTH]) for name in names[:_MAX_NAMES]]
    more = len(names) - len(shown)
    return ", ".join(shown) + (f" and {more:,} more" if more else "")


def printable(text: str) -> str:
    """Make untrusted text safe for terminals and JSON: cut it, replace control characters and lone surrogates.

    >>> printable("a" + chr(0) + "b")
    'a\N{REPLACEMENT CHARACTER}b'
    """
    cut = text if len(text) <= _MAX_TEXT else text[:_MAX_TEXT] + "..."
    return "".join("\ufffd" if unicodedata.category(letter).startswith("C") else letter for letter in cut)


def _printable_problem(problem: Problem) -> Problem:
    texts = {field.name: getattr(problem, field.name) for field in fields(problem)}
    shown: dict[str, Any] = {name: printable(text) for name, text in texts.items() if text is not None}
    return replace(problem, **shown)


class PipelineError(Exception):
    """Base of the errors that carry a message for users and a stable code.

    Examples
    --------
    >>> issubclass(InputError, PipelineError), PipelineError.code
    (True, 'pipeline_error')
    """

    code: ClassVar[Code] = PIPELINE_ERROR


class InputError(PipelineError):
    """The input is unusable; ``problems`` lists everything that is wrong with it. A retry fails the same way.

    Parameters
    ----------
    problems
        Everything that is wrong with the input.

    Examples
    --------
    >>> error = InputError([Problem("no_overlap", "The videos do not overlap.", hint="Check the offsets.")])
    >>> [problem.code for problem in error.problems]
    ['no_overlap']
    """

    code: ClassVar[Code] = INPUT_ERROR

    def __init__(self, problems: Sequence[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(str(problem) for problem in listed(self.problems)))

    def __reduce__(self) -> tuple[type["InputError"], tuple[Sequence[Problem]]]:
        """Pickle the error by its problems: detection processes raise it, too."""
        return type(self), (self.problems,)


class SessionRefused(InputError):  # noqa: N818 - named for what became of the session
    """The check of a session found errors: ``problems``. With the choice ``force`` it is reconstructed all the same.

    Parameters
    ----------
    problems
        Errors of the check.

    Examples
    --------
    >>> error = SessionRefused([Problem("upside_down", "The people stand on their heads.")])
    >>> str(error).splitlines()[-1]
    'Correct the capture, or reconstruct it anyway: `--force`, `force`.'
    """

    code: ClassVar[Code] = SESSION_REFUSED
    advice: ClassVar[str] = "Correct the capture, or reconstruct it anyway: `--force`, `force`."

    def __str__(self) -> str:
        """Problems, one a line, and what to do."""
        return f"{super().__str__()}\n{self.advice}"


class ChildError(PipelineError):
    """A process of Multicap's own failed; the input is not at fault, and a retry may succeed.

    Examples
    --------
    >>> issubclass(ChildError, InputError)
    False
    """

    code: ClassVar[Code] = CHILD_FAILED


class ModelError(PipelineError):
    """A detector network or the sample capture can't be installed or used; once it is, a retry may succeed.

    Examples
    --------
    >>> str(ModelError("The network movenet-multipose is not installed."))
    'The network movenet-multipose is not installed.'
    """

    code: ClassVar[Code] = MODEL_ERROR
