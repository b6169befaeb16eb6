"""Options that several commands share."""

from typing import Annotated, cast, get_args

import typer

from pipeline.config import Method
from pipeline.errors import InputError, Problem

METHODS: tuple[str, ...] = get_args(Method)

MethodOption = Annotated[str, typer.Option(help=f"How detections become tracks: {' or '.join(METHODS)}.")]
"""To be checked by ``known_method``, which reports a wrong one as any other problem."""


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
