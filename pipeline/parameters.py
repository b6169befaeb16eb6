"""Change a method's parameters by name."""

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any, TypeVar

import numpy as np

from pipeline.errors import InputError, Problem

_Parameters = TypeVar("_Parameters", bound=Any)


def change_parameters(parameters: _Parameters, changes: Mapping[str, float]) -> _Parameters:
    """Set some fields of a record of parameters; 0 and 1 say no and yes where a field is a choice.

    Raises
    ------
    InputError
        With every name that is none, and every value that a parameter can't have: all are positive numbers, but for
        weights, which may be 0.
    """
    known = {field.name: type(getattr(parameters, field.name)) for field in fields(parameters)}
    problems = []
    for name, value in changes.items():
        if name not in known:
            hint = f"Known are {', '.join(known)}."
            problems.append(Problem("unknown_parameter", f"The method has no parameter {name!r}.", hint=hint))
        elif wrong := _what_is_wrong(name, known[name], value):
            problems.append(Problem("parameter_range", f"{name} must be {wrong}, not {value:g}.", field=name))
    if problems:
        raise InputError(problems)
    values: dict[str, Any] = {name: known[name](value) for name, value in changes.items()}
    changed: _Parameters = replace(parameters, **values)
    return changed


def _what_is_wrong(name: str, kind: type, value: float) -> str | None:
    if kind is bool:
        return None if value in {0, 1} else "0 or 1"
    if not np.isfinite(value) or value < 0 or (value == 0 and not name.startswith("weight")):
        return "a positive number"
    if kind is int and value != int(value):
        return "a whole number"
    return None
