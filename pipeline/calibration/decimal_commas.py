"""Decimal commas in calibration files: found, and read as points where nothing else can be meant."""

import re

# Between the items of a list a comma is followed neither by a zero with more digits nor by so many digits.
_WITH_COMMA = re.compile(rb"-?\d+,(?:0\d|\d{6})\d*")
_WITH_POINT, _ANY_COMMA = re.compile(rb"\d\.\d"), re.compile(rb"(?<=\d),(?=\d)")

COMMA_HINT = "Write decimal points."


def comma_in(content: bytes) -> str | None:
    """First number with a decimal comma, in text with more of these than of points; ``None`` otherwise.

    Versions of programs and of formats have points in files of any language.
    """
    found = _WITH_COMMA.findall(content)
    return found[0].decode() if len(found) > len(_WITH_POINT.findall(content)) else None


def comma_message(comma: str) -> str:
    """Message of the problem of a file whose decimal commas can't be read."""
    return f"The numbers have decimal commas, such as {comma}, which can't be told from the commas between numbers."


def with_points(content: bytes) -> bytes:
    """Text in which numbers with decimal commas have points; spaces, quotes or tags separate the numbers."""
    return _ANY_COMMA.sub(b".", content)
