"""Byte ranges and entity tags of files whose content never changes (RFC 9110, sections 13 and 14)."""

import re
from dataclasses import dataclass

_ONE_RANGE = re.compile(r"bytes[ \t]*=[ \t]*(\d{0,18})-(\d{0,18})[ \t]*", re.ASCII | re.IGNORECASE)
_ETAG = re.compile(r'(?:W/)?("[^"]*")')


@dataclass(frozen=True, slots=True)
class ByteRange:
    """Bytes from ``start`` up to ``stop``, which is excluded."""

    start: int
    stop: int


class UnsatisfiableRange(Exception):  # noqa: N818 - RFC 9110's word
    """The range begins after the end of the file."""


def requested_range(header: str | None, size: int) -> ByteRange | None:
    """Parse a ``Range`` header.

    Returns
    -------
        ``None`` for the whole file: without a header, and if the header is malformed, has another unit or several
        ranges. A server may ignore such headers.

    Raises
    ------
    UnsatisfiableRange
        If the range contains no byte of the file.

    >>> requested_range("bytes=-100", 1000)
    ByteRange(start=900, stop=1000)
    """
    match = _ONE_RANGE.fullmatch(header or "")
    if match is None or not any(match.groups()):
        return None
    first, last = match.groups()
    if not first:
        start, stop = max(0, size - int(last)), size
    else:
        start, stop = int(first), min(int(last) + 1, size) if last else size
        if last and int(last) < start:
            return None
    if start >= stop:
        raise UnsatisfiableRange
    return ByteRange(start, stop)


def matches(header: str | None, etag: str) -> bool:
    """Whether an ``If-None-Match`` header names an entity tag or is ``*``."""
    if header is None:
        return False
    return header.strip() == "*" or etag in _ETAG.findall(header)
