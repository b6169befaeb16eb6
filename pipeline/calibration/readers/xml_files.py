"""XML files of strangers: their root, and numbers in attributes."""

import math
from typing import Any

from defusedxml.ElementTree import fromstring

from pipeline.errors import InputError, Problem
from pipeline.parsing import Quantity, UnreadableError, parse
from pipeline.problem_codes.sessions import CALIBRATION_UNREADABLE, INVALID_NUMBER

NUMBER = Quantity(-1e9, 1e9, "")
"""Range of every number in a file, so that the arithmetic of the readers does not overflow."""


def read_root(content: bytes, file: str) -> Any:
    """Root element of a file; ``InputError`` if it is not valid XML."""
    try:
        return parse(fromstring, content)
    except UnreadableError as error:
        message = "The file is not valid XML."
        raise InputError([Problem(CALIBRATION_UNREADABLE, message, file=file, hint="Export it again.")]) from error


def read_number(
    element: Any, tag: str, attribute: str, file: str, camera: str | None, problems: list[Problem]
) -> float:
    """Number in an attribute of a child; a missing one is 0, and a problem of the file's camera."""
    part = element.find(tag)
    try:
        value = float("" if part is None else part.get(attribute, ""))
        message = f"The attribute {attribute} of {tag} must be {NUMBER}."
    except ValueError:
        value = math.nan
        message = f"The attribute {attribute} of {tag} is missing or not a number."
    if NUMBER.holds(value):
        return value
    problems.append(Problem(INVALID_NUMBER, message, file=file, camera=camera, field=attribute))
    # A finite number, so that a missing number is reported only once.
    return 0.0
