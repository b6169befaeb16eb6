"""Findings of checks that a user asks for before a take: the shape that all checks share."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any, Literal

from pipeline.errors import Problem, printable

Severity = Literal["error", "warning"]
_DECIMALS = 4


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that a check found to be wrong or doubtful.

    Parameters
    ----------
    code
        Stable, documented code, such as ``same_place``.
    message
        Sentence for the user.
    camera
        Name of the camera; ``None`` if the finding is not about a single one.
    severity
        ``error``: a reconstruction would fail or be wrong. ``warning``: it may be worse than it could be.
    hint
        What to do; ``None`` if there is nothing to say.
    evidence
        Measured number, in the unit that the message names; ``None`` if there is none.
    """

    code: str
    message: str
    camera: str | None = None
    severity: Severity = "warning"
    hint: str | None = None
    evidence: float | None = None


def from_problem(problem: Problem) -> Finding:
    """Finding of a problem of the input: an error, which names the file and the field."""
    parts = ((kind, value) for kind, value in (("file", problem.file), ("field", problem.field)) if value)
    where = ", ".join(f"{kind} {value}" for kind, value in parts)
    message = f"{where}: {problem.message}" if where else problem.message
    return Finding(problem.code, message, problem.camera, "error", problem.hint)


def documents(findings: Iterable[Finding]) -> list[dict[str, Any]]:
    """Findings as JSON objects, errors first; names from files are made printable."""
    ordered = sorted(findings, key=lambda one: one.severity != "error")
    return [
        {
            **asdict(one),
            "camera": None if one.camera is None else printable(one.camera),
            "message": printable(one.message),
            "evidence": None if one.evidence is None else round(one.evidence, _DECIMALS),
        }
        for one in ordered
    ]


def has_error(findings: Iterable[Finding]) -> bool:
    """Whether a finding is an error."""
    return any(one.severity == "error" for one in findings)
