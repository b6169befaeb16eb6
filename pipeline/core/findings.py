"""Findings of checks, before and after a reconstruction: the shape that all checks share. Standard library only.

Errors refuse a session unless it is forced, see ``pipeline.run.session_check.verdict``. Files that can't be used at all
raise ``InputError``.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from pipeline.core.errors import Problem, printable
from pipeline.core.problems.code_group import Code
from pipeline.core.problems.finding_codes import TOO_FEW_CAMERAS, WORLD_UNIT
from pipeline.core.problems.request_codes import CALIBRATION_UNPOSED

Severity = Literal["error", "warning", "info"]
_SEVERITIES: tuple[Severity, ...] = get_args(Severity)
_DECIMALS = 4

CERTAIN = frozenset({TOO_FEW_CAMERAS, CALIBRATION_UNPOSED, WORLD_UNIT})
"""Codes of errors of cameras alone with which no person can be located: no people outweigh them."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that a check found to be wrong, doubtful or worth knowing."""

    code: Code  # Stable, documented code, such as ``same_place``
    message: str  # Sentence for the user
    camera: str | None = None  # Name of the camera; ``None`` if the finding is not about a single one
    # ``error``: a reconstruction would fail or be wrong. ``warning``: it may be worse than it could be. ``info``:
    # something to know.
    severity: Severity = "warning"
    hint: str | None = None  # Remedy; ``None`` if there is none
    # Measured values by name: numbers with their units in the names, ``file`` for the name of a file,
    # ``other_camera`` for a second camera. JSON values.
    evidence: Mapping[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        """Sentences for the user, printable: the camera, unless the message begins with it, the message and the hint.

        >>> str(Finding("blurred", "The picture is blurred.", "left", hint="Focus the camera."))
        'left: The picture is blurred. Focus the camera.'
        """
        is_named = not self.camera or self.message.startswith((f"{self.camera}: ", f"{self.camera} "))
        text = self.message if is_named else f"{self.camera}: {self.message}"
        return " ".join(printable(part) for part in (text, self.hint) if part)

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> "Finding":
        """Read what ``to_json`` made."""
        return cls(**document)

    def to_json(self) -> dict[str, Any]:
        """JSON object; names from files are made printable, and numbers are rounded."""
        return {
            "code": self.code,
            "message": printable(self.message),
            "camera": None if self.camera is None else printable(self.camera),
            "severity": self.severity,
            "hint": None if self.hint is None else printable(self.hint),
            "evidence": {name: _shown(value) for name, value in self.evidence.items()},
        }


@dataclass(frozen=True, slots=True)
class SessionCheck:
    """Check of a session by the people in view at a few instants."""

    findings: tuple[Finding, ...] = ()  # Sentence about the fault
    people: Mapping[str, int] = field(default_factory=dict)  # Number of people by camera, at all instants together
    num_instants: int = 0  # Number of instants
    num_located: int = 0  # Number of people located by pairs of cameras that agree, at all instants together
    forced: tuple[Code, ...] = ()  # Codes of the errors in spite of which the session is reconstructed


def _shown(value: Any) -> Any:
    if isinstance(value, str):
        return printable(value)
    return round(value, _DECIMALS) if isinstance(value, float) else value


def from_problem(problem: Problem, severity: Severity = "error") -> Finding:
    """Finding of a problem of the input, whose evidence are the file and the field."""
    parts = {kind: value for kind, value in (("file", problem.file), ("field", problem.field)) if value}
    where = ", ".join(f"{kind} {value}" for kind, value in parts.items())
    message = f"{where}: {problem.message}" if where else problem.message
    return Finding(problem.code, message, problem.camera, severity, problem.hint, parts)


def worst_first(findings: Iterable[Finding]) -> list[Finding]:
    """Findings by severity, errors first; findings of a severity keep their order."""
    return sorted(findings, key=lambda finding: _SEVERITIES.index(finding.severity))


def documents(findings: Iterable[Finding]) -> list[dict[str, Any]]:
    """Findings as JSON objects, errors first."""
    return [finding.to_json() for finding in worst_first(findings)]


def has_error(findings: Iterable[Finding]) -> bool:
    """True if a finding is an error."""
    return any(finding.severity == "error" for finding in findings)
