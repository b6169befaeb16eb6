"""Cases of a law: a few are quick, the others go the same way through the code and have the mark `slow`.

Of studies of accuracy a few cases are slow tests, the others have the mark `accuracy`.
"""

from collections.abc import Collection, Iterable
from typing import Any

import pytest


def slow_but(quick: Collection[Any], cases: Iterable[Any]) -> list[Any]:
    """Mark the cases as slow that are not among the quick ones; a tuple holds the values of several parameters."""
    return _marked(quick, cases, pytest.mark.slow)


def accuracy_but(kept: Collection[Any], cases: Iterable[Any]) -> list[Any]:
    """Mark the cases by ``accuracy`` that are not among the kept ones; a tuple holds the values of several parameters.

    Their accuracies stand in the documentation; ``make verify-accuracy`` measures them again.
    """
    return _marked(kept, cases, pytest.mark.accuracy)


def _marked(unmarked: Collection[Any], cases: Iterable[Any], mark: pytest.MarkDecorator) -> list[Any]:
    listed = list(cases)
    assert all(case in listed for case in unmarked)
    return [
        case if case in unmarked else pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=mark)
        for case in listed
    ]
