"""Problem codes of the API and the command line, from which ``docs/problems.md`` is made.

A code is part of the API: it is never renamed. ``tests/api/contract/test_problem_codes.py`` compares this list with the
code that raises problems.
"""

from api.contract.problem_codes.commands import COMMANDS
from api.contract.problem_codes.model import CodeGroup, ProblemCode
from api.contract.problem_codes.requests import ANSWERS, FIELDS, PARTS
from api.contract.problem_codes.sessions import CALIBRATIONS, KEYPOINTS, TIMES, VIDEOS
from api.contract.problem_codes.work import JOBS, READINESS, SPECS, WARNINGS

__all__ = ["FIELDS", "GROUPS", "CodeGroup", "ProblemCode"]

GROUPS: tuple[CodeGroup, ...] = (
    ANSWERS,
    FIELDS,
    PARTS,
    SPECS,
    CALIBRATIONS,
    VIDEOS,
    KEYPOINTS,
    TIMES,
    JOBS,
    READINESS,
    WARNINGS,
    COMMANDS,
)
