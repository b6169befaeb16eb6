"""XML files of strangers: their root, and numbers in attributes."""

import math
from collections.abc import Callable, Sequence
from typing import Any

from defusedxml.ElementTree import fromstring

from pipeline.calibration.reading import Reading
from pipeline.core.errors import InputError, Problem
from pipeline.core.parsing import Quantity, UnreadableError, parse
from pipeline.core.problems.session_codes import CALIBRATION_UNREADABLE, INVALID_NUMBER

NUMBER = Quantity(-1e9, 1e9, "")
"""Range of every number in a file, so that the arithmetic of the readers does not overflow."""


def read_root(content: bytes, file: str) -> Any:
    """Root element of a file; ``InputError`` if it is not valid XML."""
    try:
        return parse(fromstring, content)
    except UnreadableError as error:
        message = "The file is not valid XML."
        raise InputError([Problem(CALIBRATION_UNREADABLE, message, file=file, hint="Export it again.")]) from error


def video_cameras(
    elements: Sequence[Any], films_video: Callable[[Any], bool], name: str, reading: Reading
) -> list[Any]:
    """Cameras that film video; the others, named by the attribute ``name``, are left out if there is one that does."""
    videos = [element for element in elements if films_video(element)]
    if videos:
        others = [element.get(name) for element in elements if not films_video(element)]
        reading.leave_out(others, "markers, no video")
    return videos


def read_number(element: Any, tag: str, attribute: str, camera: str | None, reading: Reading) -> float:
    """Number in an attribute of a child; a missing one is 0, and a problem of the camera."""
    part = element.find(tag)
    try:
        value = float("" if part is None else part.get(attribute, ""))
        message = f"The attribute {attribute} of {tag} must be {NUMBER}."
    except ValueError:
        value = math.nan
        message = f"The attribute {attribute} of {tag} is missing or not a number."
    if NUMBER.holds(value):
        return value
    reading.complain(INVALID_NUMBER, message, camera, attribute)
    # A finite number, so that a missing number is reported only once.
    return 0.0
