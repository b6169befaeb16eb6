"""Findings about a calibration from the people of a take, out of the report of its quality."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from pipeline.core.findings import CERTAIN, Finding
from pipeline.export.quality.report import all_checks

# Checks of the capture that tell of the calibration; others are about the take.
_NOBODY = "nobody_found"
_OF_CAPTURE = frozenset({_NOBODY, "camera_without_people"})
# Checks that people decide better than the cameras alone.
_BY_PEOPLE = frozenset({"upside_down", "not_upright", "camera_below_floor"})
# Findings with which people are located nowhere, or wrongly.
_UNDECIDED = frozenset({_NOBODY, "nobody_detected", "same_video", "calibration_of_another_rig"})


def people_findings(report: Mapping[str, Any]) -> list[Finding]:
    """Failed checks of a take that tell of its calibration.

    ``report`` is that of ``pipeline.export.quality.report.quality_report``.
    """
    of_world = {finding["code"] for finding in report["world_checks"]}
    return [finding for finding in all_checks(report) if finding.code in _OF_CAPTURE | of_world]


def join_findings(alone: Sequence[Finding], of_people: Sequence[Finding]) -> list[Finding]:
    """Join findings about cameras alone with those of people, who decide what is up and where the floor is.

    What is wrong with cameras is seen by the people: errors of the cameras alone become warnings, but for those with
    which nobody could be located.
    """
    if not any(finding.code in _UNDECIDED for finding in of_people):
        alone = [finding for finding in alone if finding.code not in _BY_PEOPLE]
    return [*(finding if finding.code in CERTAIN else _outweighed(finding) for finding in alone), *of_people]


def _outweighed(finding: Finding) -> Finding:
    return replace(finding, severity="warning") if finding.severity == "error" else finding
