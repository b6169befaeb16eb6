"""Clocks that a container states for its first frame: SMPTE timecode, and the time of its creation.

Timecode counts frames of a clock that cameras share after they were synchronised (jam sync). Drop-frame timecode leaves
out two numbers in each minute but every tenth, so that 29.97 frames a second keep up with the time of day (SMPTE 12M).
"""

import re
import struct
from collections.abc import Iterator, Mapping
from datetime import datetime
from fractions import Fraction
from pathlib import Path
from typing import BinaryIO

from pipeline.video.info import Timecode

_TIMECODE = re.compile(r"(\d\d):(\d\d):(\d\d)([:;.,])(\d{2,3})")
_DROP_MARKS = ";.,"
# Two numbers are dropped at 29.97, four at 59.94 frames a second.
_DROP_BASE = 30
_DROPPED = 2

_MAX_TIMECODE_HZ = 240
_MAX_HEADER_BYTES = 2**26
_MAX_BOXES = 4096
_PARENTS = frozenset({b"moov", b"trak", b"mdia", b"minf", b"stbl"})
# Before 1980 no camera wrote files; 0 is what cameras without a clock write.
_FIRST_YEAR = 1980


def read_timecode(path: Path, metadata: Mapping[str, str], frame_rate: Fraction | None) -> Timecode | None:
    """Read the timecode of the first frame; ``None`` if there is none, or a malformed one.

    ``metadata`` are entries of the container and of its streams; ``frame_rate`` counts where the container does not
    state the clock of its timecode.
    """
    text = metadata.get("timecode") or metadata.get("TIMECODE")
    if not text or (rate := timecode_rate(path) or frame_rate) is None:
        return None
    time_s = timecode_s(text, rate)
    return None if time_s is None else Timecode(time_s, float(rate), _is_drop_frame(text.strip()[8], rate))


def timecode_s(text: str, rate: Fraction) -> float | None:
    """Time since midnight in seconds that a timecode stands for; ``None`` for malformed text.

    ``text``: hours, minutes, seconds and frames; a semicolon, point or comma before the frames marks drop-frame
    timecode. ``rate``: frames a second, such as 30000/1001. A clock of 30000/1001 Hz without dropped numbers takes
    3603.6 s for an hour.

    >>> timecode_s("01:00:00:00", Fraction(25)), timecode_s("01:00:00;00", Fraction(30000, 1001))
    (3600.0, 3599.9964)
    """
    if (match := _TIMECODE.fullmatch(text.strip())) is None or not 1 <= rate <= _MAX_TIMECODE_HZ:
        return None
    hours, minutes, seconds, frames = (int(match[k]) for k in (1, 2, 3, 5))
    base = round(rate)
    if hours >= 24 or minutes >= 60 or seconds >= 60 or frames >= base:
        return None
    number = ((hours * 60 + minutes) * 60 + seconds) * base + frames
    if _is_drop_frame(match[4], rate):
        total_minutes = hours * 60 + minutes
        number -= _DROPPED * base // _DROP_BASE * (total_minutes - total_minutes // 10)
    return float(number / rate)


def _is_drop_frame(mark: str, rate: Fraction) -> bool:
    """Return whether a mark before the frames means dropped numbers; at 25 frames a second there are none."""
    return mark in _DROP_MARKS and round(rate) % _DROP_BASE == 0


def created_s(metadata: Mapping[str, str]) -> float | None:
    """Time of creation in seconds since 1970 (UTC); ``None`` if there is none, or one before there were such files."""
    try:
        created = datetime.fromisoformat(metadata.get("creation_time", "").replace("Z", "+00:00"))
    except ValueError:
        return None
    return created.timestamp() if created.tzinfo is not None and created.year >= _FIRST_YEAR else None


def timecode_rate(path: Path) -> Fraction | None:
    """Frames a second of the timecode track of an MP4 or MOV file; ``None`` if there is none.

    FFmpeg reads the track's timecode, but does not pass its rate on, which may be a part of the video's rate.
    """
    with path.open("rb") as file:
        for kind, content in _boxes(file, 0, path.stat().st_size, [_MAX_BOXES]):
            # Sample description: version, flags, number of entries; then the first entry. Its type is followed by
            # reserved bytes and the data reference (8 bytes), reserved bytes, flags, time scale, duration of a frame.
            if kind == b"stsd" and content[12:16] == b"tmcd" and len(content) >= 40:
                scale, duration = struct.unpack_from(">II", content, 32)
                return Fraction(scale, duration) if scale and duration else None
    return None


def _boxes(file: BinaryIO, start: int, stop: int, left: list[int]) -> Iterator[tuple[bytes, bytes]]:
    """Types and beginnings of sample descriptions of a QuickTime file; at most ``left`` boxes are read."""
    while start + 8 <= stop and left[0] > 0:
        left[0] -= 1
        file.seek(start)
        size, kind = struct.unpack(">I4s", file.read(8))
        head = 8
        if size == 1:
            large = file.read(8)
            size, head = (int.from_bytes(large), 16) if len(large) == 8 else (0, 8)
        end = stop if size == 0 else start + size
        if end > stop or end <= start + head - 1:
            return
        if kind in _PARENTS and end - start <= _MAX_HEADER_BYTES:
            yield from _boxes(file, start + head, end, left)
        elif kind == b"stsd":
            yield kind, file.read(min(end - start - head, 64))
        start = end
