"""Output of a task. Standard library only."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pipeline.edits import PersonSpan
from pipeline.findings import Finding

VIEWER = "viewer"
"""Kind of the files that viewers read; lists of downloads leave them out."""
MOTION, DESCRIPTION = "motion.bin", "motion.json"
"""Names of these files."""


@dataclass(frozen=True, slots=True)
class ResultFile:
    """A result file for the client. The executor may move it away from ``path``.

    ``person`` is the number of a person as in ``name``, ``person_name`` the person's name.
    """

    name: str
    kind: str
    person: str | None
    media_type: str
    path: Path
    person_name: str | None = None


@dataclass(frozen=True, slots=True)
class Output:
    """Output of a task.

    Parameters
    ----------
    content
        Bytes that later stages read.
    files
        Result files, of the last stage only.
    warnings
        Findings about the results, for the last stage only.
    interim
        Bytes that later stages of the same job read, and that are removed when the job ends; ``None``: there are none.
    calibration
        Calibration that the job has made: ``files``, texts by format, and ``report``.
    pieces
        Files with pieces of the output, by key: kept with the session, so that later tasks find them. See
        ``pipeline.stages.results.pieces``.
    people
        People whom the job has found, before any edit; ``None`` of a task that writes no results.
    """

    content: bytes
    files: tuple[ResultFile, ...] = ()
    warnings: tuple[Finding, ...] = ()
    interim: bytes | None = None
    calibration: Mapping[str, Any] | None = None
    pieces: Mapping[str, Path] = field(default_factory=dict)
    people: tuple[PersonSpan, ...] | None = None
