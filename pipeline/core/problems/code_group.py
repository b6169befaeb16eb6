"""Declaration of problem codes in groups; each group is a section of ``docs/reference/problems.md``."""

import ast
import inspect
from dataclasses import dataclass, field
from itertools import pairwise
from types import ModuleType
from typing import Literal, NewType

Code = NewType("Code", str)
"""Stable name of a problem, such as ``video_truncated``. It is part of the API and never changes."""

Place = Literal["live", "recording", "job", "waiting", "attempt", "readyz", "command", "warning", "finding"]


@dataclass(frozen=True, slots=True)
class CodeGroup:
    """Problem codes about one subject."""

    title: str
    introduction: str
    places: dict[Code, tuple[int | Place, ...]] = field(default_factory=dict, init=False)

    def code(self, name: str, *places: int | Place) -> Code:
        """Declare a code. A text follows the declaration: the code's meaning, a bar, and the remedy.

        ``places``: places in which clients meet the code: HTTP statuses of answers, the usual one first; ``job`` (the
        error of a job), ``waiting`` (what a job waits for), ``attempt`` (a failed attempt at a chunk), ``readyz`` (the
        errors of ``/readyz``), ``command`` (the command line), ``warning`` (a warning of a job and in
        ``metrics.json``), ``finding`` (of a check), ``live`` and ``recording`` (a message of their WebSockets).
        """
        code = Code(name)
        self.places[code] = places
        if isinstance(places[0], int):
            _STATUSES[code] = places[0]
        return code


_STATUSES: dict[Code, int] = {}


def usual_status(code: Code) -> int:
    """Usual status of an answer with a code."""
    return _STATUSES[code]


def read_sentences(module: ModuleType) -> dict[Code, tuple[str, str]]:
    """Meaning and remedy of each code that a module declares, from the texts that follow the declarations."""
    sentences: dict[Code, tuple[str, str]] = {}
    for statements in pairwise(ast.parse(inspect.getsource(module)).body):
        match statements:
            case ast.Assign(targets=[ast.Name(id=name)]), ast.Expr(value=ast.Constant(value=str(row))):
                meaning, _, remedy = " ".join(row.split()).partition(" | ")
                sentences[vars(module)[name]] = meaning, remedy
    return sentences
