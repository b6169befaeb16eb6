"""All problem codes, with their meanings and statuses: the source of ``docs/problems.md`` and of the API's answers.

A code is part of the API: it is never renamed. ``tests/api/contract/test_problem_codes.py`` compares this list with the
code that raises problems.
"""

from collections.abc import Mapping

from api.contract.problem_codes.commands import COMMANDS, FINDINGS
from api.contract.problem_codes.findings import FILES, PEOPLE
from api.contract.problem_codes.model import CodeGroup, ProblemCode
from api.contract.problem_codes.requests import ANSWERS, FIELDS, PARTS
from api.contract.problem_codes.sessions import CALIBRATIONS, KEYPOINTS, TIMES, VIDEOS
from api.contract.problem_codes.work import EDITS, JOBS, READINESS, SPECS, WARNINGS

__all__ = ["FIELDS", "GROUPS", "STATUSES", "CodeGroup", "ProblemCode"]

GROUPS: tuple[CodeGroup, ...] = (
    ANSWERS,
    FIELDS,
    PARTS,
    SPECS,
    CALIBRATIONS,
    VIDEOS,
    KEYPOINTS,
    TIMES,
    FILES,
    EDITS,
    PEOPLE,
    JOBS,
    READINESS,
    WARNINGS,
    COMMANDS,
    FINDINGS,
)

STATUSES: Mapping[str, int] = {code.name: code.statuses[0] for group in GROUPS for code in group.codes if code.statuses}
"""Status of the answer whose ``code`` is one of these."""
