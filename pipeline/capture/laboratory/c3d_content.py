"""Content of a C3D file: parameters, analog samples as they are stored, and events.

Files of all three processors are read: Intel, DEC and MIPS, with integers or floats. ``ANALOG:FORMAT`` states whether
integers are unsigned. The number of frames is in ``TRIAL:ACTUAL_*_FIELD`` or ``POINT:LONG_FRAMES``, else in the header.
Format: https://www.c3d.org, "The C3D File Format: A Technical User Guide".
"""

import struct
from itertools import chain
from typing import NamedTuple

import numpy as np

from pipeline.core.data.laboratory import Groups, LaboratoryEvent, Value, continued

BLOCK_BYTES = 512
_KEY, _INTEL, _DEC, _MIPS = 0x50, 84, 85, 86
_TEXT, _BYTE, _WORD, _FLOAT = -1, 1, 2, 4
_HEADER = "BBHHHHHfHHf"
_MAX_WORD = 0xFFFF
_SECONDS_PER_MINUTE = 60.0


class C3dError(Exception):
    """The file can't be used; the text is the message of its problem."""


class C3dHeader(NamedTuple):
    """Facts of a file's header."""

    num_points: int
    samples_per_frame: int  # Analog numbers of a frame, of all channels
    first_frame: int
    last_frame: int
    scale: float  # Negative: the scale of residuals; points are floats
    first_block: int  # First block of the points, counted from 1
    samples_per_channel: int  # Samples of a channel in a frame
    frame_rate_hz: float


class C3dContent(NamedTuple):
    """Parameters and samples of a file."""

    groups: Groups
    frame_rate_hz: float
    num_frames: int
    samples_per_frame: int  # Of a channel
    samples: np.ndarray  # (samples, channels), float32, as they are stored
    events: tuple[LaboratoryEvent, ...]


def read_content(content: bytes) -> C3dContent:
    """Read a file; raises ``C3dError`` with a sentence, for any content."""
    if len(content) < 2 * BLOCK_BYTES or content[1] != _KEY:
        raise C3dError("The file is no C3D file.")
    try:
        start = (max(content[0], 1) - 1) * BLOCK_BYTES
        processor = content[start + 3]
        if processor not in (_INTEL, _DEC, _MIPS):
            raise C3dError("The parameters of the file state no processor: the file is damaged.")
        groups = read_parameters(content[start : start + content[start + 2] * BLOCK_BYTES], processor)
        return _with_samples(content, read_header(content, processor), groups, processor)
    except (IndexError, KeyError, TypeError, ValueError, struct.error, OverflowError):
        raise C3dError("The parameters of the file are damaged.") from None


def read_header(content: bytes, processor: int = _INTEL) -> C3dHeader:
    """Read the header of a file."""
    order = ">" if processor == _MIPS else "<"
    _, _, points, numbers, first, last, _, scale, block, per_channel, rate_hz = struct.unpack_from(
        order + _HEADER, content
    )
    if processor == _DEC:
        scale, rate_hz = (float(_dec_floats(content[place : place + 4])[0]) for place in (12, 20))
    return C3dHeader(points, numbers, first, last, scale, block, per_channel, rate_hz)


def read_parameters(content: bytes, processor: int = _INTEL) -> dict[str, dict[str, Value]]:
    """Values in the blocks of parameters by group and name; numbers have the file's dimensions in reverse order.

    Raises ``ValueError``, ``IndexError`` or ``struct.error`` for damaged ones.
    """
    order = ">" if processor == _MIPS else "<"
    names: dict[int, str] = {}
    values: list[tuple[int, str, Value]] = []
    place, step = 4, 1
    while step and place + 2 < len(content):
        length, number = struct.unpack_from("<bb", content, place)
        name = content[place + 2 : place + 2 + abs(length)].decode("latin-1").strip().upper()
        place += 2 + abs(length)
        if not length:
            break
        (step,) = struct.unpack_from(order + "H", content, place)
        if number < 0:
            names[-number] = name
        else:
            values.append((number, name, _value(content, place + 2, processor)))
        place += step
    groups: dict[str, dict[str, Value]] = {name: {} for name in names.values()}
    for number, name, value in values:
        groups[names[number]].setdefault(name, value)
    return groups


def _value(content: bytes, place: int, processor: int) -> Value:
    """Value of a parameter whose type is at a place."""
    code, num_dimensions = struct.unpack_from("<bB", content, place)
    dimensions = list(content[place + 2 : place + 2 + num_dimensions])
    place += 2 + num_dimensions
    count = int(np.prod(dimensions, initial=1))
    size = {_TEXT: 1, _BYTE: 1, _WORD: 2, _FLOAT: 4}[code]
    stored = content[place : place + count * size]
    if len(stored) < count * size:
        raise ValueError
    if code == _TEXT:
        width = dimensions[0] if dimensions else 1
        rows = range(0, count, width) if width else ()
        return [stored[row : row + width].decode("latin-1").rstrip(" \0") for row in rows]
    return _numbers(stored, {_BYTE: "u1", _WORD: "u2", _FLOAT: "f4"}[code], processor).reshape(dimensions[::-1] or [1])


def _numbers(stored: bytes, kind: str, processor: int) -> np.ndarray:
    """Numbers as they are stored, in the order of this machine."""
    if kind == "f4" and processor == _DEC:
        return _dec_floats(stored)
    return np.frombuffer(stored, (">" if processor == _MIPS else "<") + kind).astype(kind)


def _dec_floats(stored: bytes) -> np.ndarray:
    """Floats of a VAX, whose words are swapped and whose exponents are greater by 2."""
    words = np.frombuffer(stored, "<u2").reshape(-1, 2)[:, ::-1]
    with np.errstate(invalid="ignore", over="ignore"):
        return np.ascontiguousarray(words).view("<f4").ravel() / np.float32(4.0)


def _with_samples(content: bytes, header: C3dHeader, groups: Groups, processor: int) -> C3dContent:
    rate_hz = header.frame_rate_hz
    if not 1.0 <= rate_hz <= 1e5:
        raise C3dError(f"The file states {rate_hz:g} frames a second.")
    num_frames, ratio = _num_frames(header, groups), max(header.samples_per_channel, 1)
    kind = "f4" if header.scale < 0 else "u2" if "UNSIGNED" in groups.get("ANALOG", {}).get("FORMAT", []) else "i2"
    width = 4 * header.num_points + header.samples_per_frame
    size, place = int(kind[1]), (header.first_block - 1) * BLOCK_BYTES
    if not header.samples_per_frame or header.samples_per_frame % ratio:
        raise C3dError("The file has no analog channels, so nothing beside the cameras.")
    if num_frames < 1 or place < BLOCK_BYTES or len(content) < place + num_frames * width * size:
        whole = max(len(content) - place, 0) // (width * size)
        raise C3dError(f"The file states {num_frames:,} frames, but ends after {whole:,}: copy it again.")
    stored = memoryview(content)[place : place + num_frames * width * size]
    own = np.frombuffer(stored, f"V{width * size}")
    numbers = own.view("u1").reshape(num_frames, -1)[:, 4 * header.num_points * size :].tobytes()
    samples = _numbers(numbers, kind, processor).astype("f4").reshape(num_frames * ratio, -1)
    events = _events(groups, (header.first_frame - 1) / rate_hz, 1.0 / rate_hz)
    return C3dContent(groups, rate_hz, num_frames, ratio, samples, events)


def _num_frames(header: C3dHeader, groups: Groups) -> int:
    """Number of frames; beyond 65,535 it is in the parameters alone."""
    stated = header.last_frame - header.first_frame + 1
    if header.last_frame < _MAX_WORD:
        return stated
    trial = groups.get("TRIAL", {})
    if {"ACTUAL_START_FIELD", "ACTUAL_END_FIELD"} <= trial.keys():
        first, last = (int(np.asarray(trial[f"ACTUAL_{end}_FIELD"]) @ [1, 1 << 16]) for end in ("START", "END"))
        return last - first + 1
    for name in ("LONG_FRAMES", "FRAMES"):
        if name in groups.get("POINT", {}):
            return int(np.ravel(groups["POINT"][name])[0])
    return stated


def _events(groups: Groups, start_s: float, frame_s: float) -> tuple[LaboratoryEvent, ...]:
    """Events from the first frame on. Times count from frame 1, or from the first frame of the file."""
    times = [np.reshape(part, (-1, 2)).astype(float) for part in continued(groups, "EVENT", "TIMES")]
    times_s = np.concatenate([np.zeros((0, 2)), *times]) @ [_SECONDS_PER_MINUTE, 1.0]
    if np.nanmin(times_s, initial=np.inf) - start_s > -frame_s:
        times_s = times_s - start_s
    texts = (
        [*chain(*continued(groups, "EVENT", name)), *[""] * len(times_s)] for name in ("LABELS", "CONTEXTS", "SUBJECTS")
    )
    return tuple(
        LaboratoryEvent(str(label), str(context), str(subject), time_s)
        for label, context, subject, time_s in zip(*texts, times_s.tolist(), strict=False)
        if np.isfinite(time_s)
    )
