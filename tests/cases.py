"""Cases of a law: a few are quick, the others go the same way through the code and have the mark `slow`."""

from collections.abc import Collection, Iterable
from typing import Any

import pytest


def slow_but(quick: Collection[Any], cases: Iterable[Any]) -> list[Any]:
    """Mark the cases as slow that are not among the quick ones; a tuple holds the values of several parameters."""
    listed = list(cases)
    assert all(case in listed for case in quick)
    return [
        case if case in quick else pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.slow)
        for case in listed
    ]
