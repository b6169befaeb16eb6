"""Findings about a calibration from the people of a take, out of the report of its quality."""

from collections.abc import Mapping, Sequence
from typing import Any

from pipeline.findings import Finding

# Checks of the capture that tell of the calibration, and their severity and hint; others are about the take.
_NOBODY = "nobody_found"
_OF_CAPTURE = frozenset({_NOBODY, "camera_without_people"})
_ERRORS = frozenset({_NOBODY, "upside_down", "mirrored_world"})
# Checks that people decide better than the cameras alone.
_BY_PEOPLE = frozenset({"upside_down", "not_upright", "camera_below_floor"})


def people_findings(report: Mapping[str, Any]) -> list[Finding]:
    """Failed checks of a take that tell of its calibration.

    Parameters
    ----------
    report
        Report of ``pipeline.quality.report.quality_report``.
    """
    found = [one for one in report["capture_checks"] if one["code"] in _OF_CAPTURE] + report["world_checks"]
    return [
        Finding(
            one["code"],
            one["message"],
            one.get("camera"),
            "error" if one["code"] in _ERRORS else "warning",
            one.get("hint"),
            one.get("evidence"),
        )
        for one in found
    ]


def join_findings(alone: Sequence[Finding], of_people: Sequence[Finding]) -> list[Finding]:
    """Join findings about cameras alone with those of people, who decide what is up and where the floor is."""
    if any(one.code == _NOBODY for one in of_people):
        return [*alone, *of_people]
    return [*(one for one in alone if one.code not in _BY_PEOPLE), *of_people]
