"""Figures of a laboratory's file for ``metrics.json``, and warnings: its clock, and plates beside the feet."""

from typing import Any

from pipeline.core.data.laboratory import Laboratory
from pipeline.core.findings import Finding
from pipeline.core.problems.finding_codes import LABORATORY_ALIGNED, LABORATORY_DOUBTFUL

# Differences of a stated and a measured time that are doubtful: this long, and this many deviations.
_LATE_S, _SIGMAS = 0.03, 4.0
_APART_M = 0.4


def laboratory_document(laboratory: Laboratory | None) -> dict[str, Any]:
    """Entry ``laboratory`` of ``metrics.json``; none without a file."""
    if laboratory is None:
        return {}
    check, (clock, start_s, sigma_s) = laboratory.check, laboratory.start or (None, None, None)
    document = {
        "file": laboratory.file,
        "clock": clock,
        "start_s": _rounded(start_s, 6),
        "sigma_s": _rounded(sigma_s, 6),
        "frame_rate_hz": laboratory.frame_rate_hz,
        "num_frames": laboratory.num_frames,
        "sample_rate_hz": laboratory.sample_rate_hz,
        "world_from_laboratory": laboratory.world_from_laboratory.matrix.round(6).tolist(),
    }
    if check is not None:
        document |= {
            "measured_start_s": _rounded(check.measured and check.measured.time_s, 6),
            "is_ambiguous": check.is_ambiguous,
            "mass_kg": _rounded(check.mass_kg, 1),
            "pressure_from_feet_m": _rounded(check.apart_m, 3),
        }
    return {"laboratory": document}


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)


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
        message = f"{file} begins at {start.time_s:.4f} s, measured by {by}, +- {1000.0 * start.sigma_s:.1f} ms."
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
