"""One verdict on a session: errors of its check refuse it, by whatever way its reconstruction is asked for.

``multicap check`` lists the findings, and the stage *Checking the capture* refuses a session with errors. Nothing is
refused if the reconstruction is forced, or if its results are there already, as for edits of them. A job that refines
the calibration is judged by the refined cameras where refinement may mend the error.
"""

from collections.abc import Sequence
from dataclasses import replace

from pipeline.calibration.checks.camera_checks import certain_errors, check_cameras
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import Problem, SessionRefused
from pipeline.core.findings import Finding, SessionCheck
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.problems.finding_codes import CALIBRATION_OF_ANOTHER_RIG, CAMERA_DISAGREES, NOT_UPRIGHT, UPSIDE_DOWN
from pipeline.export.quality.report import join_findings

# Errors that refinement of the calibration may mend: it moves cameras, and levels the world.
_MENDABLE = frozenset({CAMERA_DISAGREES, CALIBRATION_OF_ANOTHER_RIG, NOT_UPRIGHT, UPSIDE_DOWN})


def session_findings(cameras: Sequence[Camera], of_people: Sequence[Finding]) -> list[Finding]:
    """Findings about cameras alone and about people in view at a few instants, joined."""
    return join_findings(check_cameras(cameras), of_people)


def require_cameras(cameras: Sequence[Camera], config: ReconstructionConfig) -> None:
    """Refuse cameras with which no person can be located, before any work.

    Raises ``SessionRefused`` unless the reconstruction is forced.
    """
    if errors := () if config.force else certain_errors(cameras):
        raise SessionRefused([_problem(error) for error in errors])


def judge(check: SessionCheck, cameras: Sequence[Camera], config: ReconstructionConfig) -> SessionCheck:
    """Judge a session by the check of its people, with the calibration as it was given.

    Returns the check; if it is forced, with the errors that were overridden. Raises ``SessionRefused`` with all errors
    if there is one that nothing overrides and no refinement may mend.
    """
    errors = _errors(cameras, check)
    if config.force and errors:
        alone = [error for error in errors if error not in check.findings]
        forced = tuple(dict.fromkeys(error.code for error in errors))
        return replace(check, findings=(*check.findings, *alone), forced=forced)
    if not _has_results(config) and any(not _is_mendable(error, config) for error in errors):
        raise SessionRefused([_problem(error) for error in errors])
    return check


def is_deferred(check: SessionCheck, cameras: Sequence[Camera], config: ReconstructionConfig) -> bool:
    """True if ``judge`` has left errors to the refinement of the calibration."""
    return not config.force and not _has_results(config) and bool(_errors(cameras, check))


def judge_refined(check: SessionCheck, refined: Sequence[Camera]) -> None:
    """Judge a session whose errors were left to the refinement, by the check with refined cameras.

    Raises ``SessionRefused`` with the errors that are left.
    """
    if errors := _errors(refined, check):
        problems = [_problem(error) for error in errors]
        raise SessionRefused(
            [replace(problem, message=f"{problem.message} Refinement did not mend it.") for problem in problems]
        )


def _errors(cameras: Sequence[Camera], check: SessionCheck) -> list[Finding]:
    return [finding for finding in session_findings(cameras, check.findings) if finding.severity == "error"]


def _is_mendable(error: Finding, config: ReconstructionConfig) -> bool:
    return config.refine_calibration == "auto" and error.code in _MENDABLE


def _has_results(config: ReconstructionConfig) -> bool:
    """Return whether a job works on results that are there: files that are made again, or rebuilt visuals."""
    return config.is_remade or config.making is not None


def _problem(error: Finding) -> Problem:
    return Problem(error.code, error.message, camera=error.camera, hint=error.hint)
