"""Calibrations that were sent, or made by a job."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from worker.store.model.jobs import JobProblem
from worker.store.model.states import JobState


@dataclass(frozen=True, slots=True)
class Calibration:
    """A calibration: sent as a file, or made by the job of the same id."""

    id: str
    name: str
    method: str  # ``file``, ``board`` or ``people``
    created_at: datetime
    # Of a file its name, format, units, axes and notes; else the choices with which it is made
    source: Mapping[str, Any]
    files: Mapping[str, str] | None  # Text by format; ``None`` until it is made
    report: Mapping[str, Any] | None  # See ``pipeline.calibration.report.report_document``; ``None`` of a file
    session_id: str | None = None  # Session from which it is made; it may be deleted since
    # State and problem of the job that makes it; ``None`` of a file, or once the job is deleted
    job_state: JobState | None = None
    problem: JobProblem | None = None


@dataclass(frozen=True, slots=True)
class MadeCalibration:
    """Calibration that a job has made; fields as of ``Calibration``."""

    files: Mapping[str, str]
    report: Mapping[str, Any]
