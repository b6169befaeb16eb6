"""Options that several commands share."""

from collections.abc import Sequence
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
    """Check the name of a method; ``InputError`` if there is none of that name."""
    return cast(Method, _known("method", name, METHODS))


def known_smoothing(name: str) -> Smoothing:
    """Check the name of a smoothing; ``InputError`` if there is none of that name."""
    return cast(Smoothing, _known("smoothing", name, SMOOTHINGS))


def _known(kind: str, name: str, names: Sequence[str]) -> str:
    if name not in names:
        hint = f"Use {', '.join(names)}."
        raise InputError([Problem(f"unknown_{kind}", f"There is no {kind} '{name}'.", hint=hint)])
    return name
