"""Findings about a calibration from the people of a take, out of the report of its quality."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from pipeline.findings import CERTAIN, Finding, Severity
from pipeline.quality.report import all_checks

# Checks of the capture that tell of the calibration; others are about the take.
_NOBODY = "nobody_found"
_OF_CAPTURE = frozenset({_NOBODY, "camera_without_people"})
# Checks that people decide better than the cameras alone.
_BY_PEOPLE = frozenset({"upside_down", "not_upright", "camera_below_floor"})
# Findings with which people are located nowhere, or wrongly.
_UNDECIDED = frozenset({_NOBODY, "nobody_detected", "same_video", "calibration_of_another_rig"})


def people_findings(report: Mapping[str, Any]) -> list[Finding]:
    """Failed checks of a take that tell of its calibration.

    ``report`` is that of ``pipeline.quality.report.quality_report``.
    """
    of_world = {finding["code"] for finding in report["world_checks"]}
    return [finding for finding in all_checks(report) if finding.code in _OF_CAPTURE | of_world]


def join_findings(alone: Sequence[Finding], of_people: Sequence[Finding]) -> list[Finding]:
    """Join findings about cameras alone with those of people, who decide what is up and where the floor is.

    What is wrong with cameras that locate people is seen by these people: errors of the cameras alone become warnings,
    but for those with which nobody could be located.
    """
    if any(finding.code in _UNDECIDED for finding in of_people):
        return [*alone, *of_people]
    left = (finding for finding in alone if finding.code not in _BY_PEOPLE)
    outweighed = (
        finding if finding.code in CERTAIN else replace(finding, severity=_milder(finding)) for finding in left
    )
    return [*outweighed, *of_people]


def _milder(finding: Finding) -> Severity:
    return "warning" if finding.severity == "error" else finding.severity
