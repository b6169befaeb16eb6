"""Figures of a laboratory's file for ``metrics.json``, and warnings: its clock, and plates beside the feet."""

from typing import Any

from pipeline.core.data.laboratory import Laboratory, LaboratoryStart
from pipeline.core.findings import Finding
from pipeline.core.problems.finding_codes import LABORATORY_ALIGNED, LABORATORY_DOUBTFUL

# Differences of a stated and a measured time that are doubtful: this long, and this many deviations.
_LATE_S, _SIGMAS = 0.03, 4.0
_APART_M = 0.4


def laboratory_document(laboratory: Laboratory | None) -> dict[str, Any]:
    """Entry ``laboratory`` of ``metrics.json``; none without a file."""
    if laboratory is None:
        return {}
    start, check = laboratory.start, laboratory.check
    pose = laboratory.world_from_laboratory
    document = {
        "file": laboratory.file,
        "clock": None if start is None else start.clock,
        "start_s": None if start is None else round(start.time_s, 6),
        "sigma_s": None if start is None else round(start.sigma_s, 6),
        "frame_rate_hz": laboratory.frame_rate_hz,
        "num_frames": laboratory.num_frames,
        "sample_rate_hz": laboratory.sample_rate_hz,
        "world_from_laboratory": pose.matrix.round(6).tolist(),
    }
    if check is not None:
        measured = check.measured
        document |= {
            "measured_start_s": None if measured is None else round(measured.time_s, 6),
            "is_ambiguous": check.is_ambiguous,
            "mass_kg": None if check.mass_kg is None else round(check.mass_kg, 1),
            "pressure_from_feet_m": None if check.apart_m is None else round(check.apart_m, 3),
        }
    return {"laboratory": document}


def laboratory_checks(laboratory: Laboratory | None) -> list[dict[str, Any]]:
    """Findings about the clock and the place of a laboratory's file."""
    return [] if laboratory is None else [finding.to_json() for finding in _findings(laboratory)]


def _findings(laboratory: Laboratory) -> list[Finding]:
    start, check, file = laboratory.start, laboratory.check, laboratory.file
    if start is None:
        message = f"The time of {file} could not be measured: no feet stand on its force plates as they are loaded."
        hint = "State the place of its axes, its trigger channel or its timecode. The C3D files are without it."
        return [Finding(LABORATORY_ALIGNED, message, hint=hint)]
    findings = []
    evidence = {"start_s": start.time_s, "sigma_s": start.sigma_s}
    if start.clock == "contacts":
        by = "contacts" if check is None or check.mass_kg is None else f"the vertical force of {check.mass_kg:.0f} kg"
        message = f"{file} begins at {start.time_s:.4f} s, measured by {by}, {_plus_minus(start)}."
        findings.append(Finding(LABORATORY_ALIGNED, message, severity="info", evidence=evidence))
        if check is not None and check.is_ambiguous:
            message = f"Another time of {file} fits nearly as well as {start.time_s:.4f} s: people repeat their motion."
            hint = "State its trigger channel or its timecode."
            findings.append(Finding(LABORATORY_DOUBTFUL, message, hint=hint, evidence=evidence))
    measured = None if check is None or check.is_ambiguous else check.measured
    if measured is not None:
        late_s = start.time_s - measured.time_s
        if abs(late_s) > max(_LATE_S, _SIGMAS * measured.sigma_s):
            message = f"{file} begins {1000 * late_s:.0f} ms later by its {start.clock} than by feet and force."
            hint = f"Check the {start.clock}, or let contacts tell the time."
            findings.append(Finding(LABORATORY_DOUBTFUL, message, hint=hint, evidence=evidence))
    if check is not None and check.apart_m is not None and check.apart_m > _APART_M:
        message = f"The centres of pressure of {file} are {check.apart_m:.2f} m from the feet, at the median."
        hint = "State the place of the laboratory's axes in the world of the calibration."
        findings.append(Finding(LABORATORY_DOUBTFUL, message, hint=hint, evidence={"apart_m": check.apart_m}))
    return findings


def _plus_minus(start: LaboratoryStart) -> str:
    return f"+- {1000.0 * start.sigma_s:.1f} ms"
