"""Change of a method's parameters by name, with a check of each value."""

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any, TypeVar

import numpy as np

from pipeline.core.errors import InputError, Problem
from pipeline.core.problems.findings import PARAMETER_RANGE, UNKNOWN_PARAMETER

_Parameters = TypeVar("_Parameters", bound=Any)


def change_parameters(parameters: _Parameters, changes: Mapping[str, float]) -> _Parameters:
    """Set fields of a dataclass of parameters.

    Parameters
    ----------
    parameters
        Dataclass instance with fields of type float, int or bool.
    changes
        New values by field name; 0 or 1 for a bool.

    Raises
    ------
    InputError
        If a name is unknown or a value is not allowed; lists all of them. Values are positive numbers; fields whose
        name begins with ``weight`` may be 0.
    """
    known = {field.name: type(getattr(parameters, field.name)) for field in fields(parameters)}
    problems = []
    for name, value in changes.items():
        if name not in known:
            hint = f"Known are {', '.join(known)}."
            problems.append(Problem(UNKNOWN_PARAMETER, f"The method has no parameter {name!r}.", hint=hint))
        elif rule := _violated_rule(name, known[name], value):
            problems.append(Problem(PARAMETER_RANGE, f"{name} must be {rule}, not {value:g}.", field=name))
    if problems:
        raise InputError(problems)
    values: dict[str, Any] = {name: known[name](value) for name, value in changes.items()}
    changed: _Parameters = replace(parameters, **values)
    return changed


def _violated_rule(name: str, kind: type, value: float) -> str | None:
    """Describe the values that a parameter may have, if this value is none of them; else return ``None``."""
    if kind is bool:
        return None if value in {0, 1} else "0 or 1"
    if not np.isfinite(value) or value < 0 or (value == 0 and not name.startswith("weight")):
        return "a positive number"
    if kind is int and value != int(value):
        return "a whole number"
    return None
