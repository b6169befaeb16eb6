"""Options that several commands share."""

from typing import Annotated, cast, get_args

import typer

from pipeline.config import Method, Smoothing
from pipeline.errors import InputError, Problem

METHODS: tuple[str, ...] = get_args(Method)
SMOOTHINGS: tuple[str, ...] = get_args(Smoothing)

MethodOption = Annotated[str, typer.Option(help=f"How detections become tracks: {' or '.join(METHODS)}.")]
"""To be checked by ``known_method``, which reports a wrong one as any other problem."""
SmoothingOption = Annotated[str, typer.Option(help=f"What becomes of the joints' positions: {', '.join(SMOOTHINGS)}.")]
"""Likewise by ``known_smoothing``."""


def known_method(name: str) -> Method:
    """Check the name of a method.

    Raises
    ------
    InputError
        If there is none of that name.
    """
    if name not in METHODS:
        hint = f"Use {' or '.join(METHODS)}."
        raise InputError([Problem("unknown_method", f"There is no method '{name}'.", hint=hint)])
    return cast(Method, name)


def known_smoothing(name: str) -> Smoothing:
    """Check the name of a smoothing.

    Raises
    ------
    InputError
        If there is none of that name.
    """
    if name not in SMOOTHINGS:
        hint = f"Use {', '.join(SMOOTHINGS)}."
        raise InputError([Problem("unknown_smoothing", f"There is no smoothing '{name}'.", hint=hint)])
    return cast(Smoothing, name)
