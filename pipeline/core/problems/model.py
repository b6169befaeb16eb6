"""Declaration of problem codes in groups; each group is a section of ``docs/problems.md``."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NewType

Code = NewType("Code", str)
"""Stable name of a problem, such as ``video_truncated``. It is part of the API and never changes."""


@dataclass(frozen=True, slots=True)
class ProblemCode:
    """A declared code with its meaning and remedy, and places in which clients meet it; see ``CodeGroup.code``."""

    name: Code
    where: Sequence[str]
    meaning: str
    remedy: str

    @property
    def statuses(self) -> tuple[int, ...]:
        """HTTP statuses of answers with the code, the usual one first."""
        return tuple(int(place) for place in self.where if place.isdecimal())


@dataclass(frozen=True, slots=True)
class CodeGroup:
    """Problem codes about one subject."""

    title: str
    introduction: str
    codes: list[ProblemCode] = field(default_factory=list, init=False)

    def code(self, name: str, where: Sequence[str], meaning: str, remedy: str) -> Code:
        """Declare a code.

        Parameters
        ----------
        where
            Places in which clients meet the code: HTTP statuses of answers as digits, the usual one first; ``job`` (the
            error of a job), ``waiting`` (what a job waits for), ``attempt`` (a failed attempt at a chunk), ``readyz``
            (the errors of ``/readyz``), ``command`` (the command line), ``warning`` (a warning of a job and in
            ``metrics.json``), ``finding`` (of a check).
        meaning, remedy
            One sentence each.
        """
        self.codes.append(declared := ProblemCode(Code(name), where, meaning, remedy))
        if declared.statuses:
            _STATUSES[declared.name] = declared.statuses[0]
        return declared.name


_STATUSES: dict[Code, int] = {}


def status_of(code: Code) -> int:
    """Usual status of an answer with a code."""
    return _STATUSES[code]
