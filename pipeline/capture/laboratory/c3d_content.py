"""Content of a C3D file: parameters, points, poses of segments, analog samples as they are stored, and events.

Files of all three processors are read: Intel, DEC and MIPS, with integers or floats. ``ANALOG:FORMAT`` states whether
integers are unsigned. The header tells how many numbers a frame has: some files have analog numbers without parameters
of them. The number of frames is in ``TRIAL:ACTUAL_*_FIELD`` or ``POINT:LONG_FRAMES``, else in the header.
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
_OF_POSES = {"USED", "RATIO", "DATA_START"}


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
    first_frame: int  # Counted from 0
    points: np.ndarray  # (frames, points, 3), float32, in the file's unit; NaN where a point is unknown
    poses: np.ndarray  # (frames, segments, 4, 4), float32, of the group ROTATION; NaN where a segment is unknown


def read_content(content: bytes) -> C3dContent:
    """Read a file; raises ``C3dError`` with a sentence, for any content."""
    if len(content) < 2 * BLOCK_BYTES or content[1] != _KEY:
        raise C3dError("The file is no C3D file.")
    try:
        start = (max(content[0], 1) - 1) * BLOCK_BYTES
        processor = content[start + 3]
        if processor not in (_INTEL, _DEC, _MIPS):
            raise C3dError("The parameters of the file state no processor: the file is damaged.")
        header = read_header(content, processor)
        # Some files state fewer blocks of parameters than they have before their points.
        num_blocks = max(content[start + 2], header.first_block - content[0])
        groups = read_parameters(content[start : start + num_blocks * BLOCK_BYTES], processor)
        return _with_samples(content, header, groups, processor)
    except (IndexError, KeyError, TypeError, ValueError, struct.error, ArithmeticError):
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
    place, step, left = 4, 1, len(content)
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
            value, num_bytes = _value(content, place + 2, processor)
            values.append((number, name, value))
            left -= num_bytes
            if left < 0:  # values in each other's bytes would take any memory
                raise ValueError
        place += step
    groups: dict[str, dict[str, Value]] = {name: {} for name in names.values()}
    for number, name, value in values:
        if number in names:  # files that were edited keep parameters of groups that are gone
            groups[names[number]].setdefault(name, value)
    return groups


def _value(content: bytes, place: int, processor: int) -> tuple[Value, int]:
    """Value of a parameter whose type is at a place, and its number of bytes."""
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
        return [stored[row : row + width].decode("latin-1").rstrip(" \0") for row in rows], len(stored)
    numbers = _numbers(stored, {_BYTE: "u1", _WORD: "u2", _FLOAT: "f4"}[code], processor)
    return numbers.reshape(dimensions[::-1] or [1]), len(stored)


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
    num_samples = header.samples_per_frame
    if num_samples % ratio:  # the MotionMonitor states channels in place of their samples
        num_samples = int(np.ravel(groups["ANALOG"]["USED"])[0]) * ratio
    width = 4 * header.num_points + num_samples
    size, place = int(kind[1]), (header.first_block - 1) * BLOCK_BYTES
    if num_frames < 1 or place < BLOCK_BYTES or len(content) < place + num_frames * width * size:
        whole = max(len(content) - place, 0) // (width * size)
        raise C3dError(f"The file states {num_frames:,} frames, but ends after {whole:,}: copy it again.")
    stored = memoryview(content)[place : place + num_frames * width * size]
    frames = np.frombuffer(stored, "u1").reshape(num_frames, -1)
    located, numbers = np.split(frames, [4 * header.num_points * size], axis=1)
    samples = _numbers(numbers.tobytes(), kind, processor).astype("f4").reshape(num_frames * ratio, -1)
    events = _events(groups, (header.first_frame - 1) / rate_hz, 1.0 / rate_hz)
    words = _numbers(located.tobytes(), "f4" if header.scale < 0 else "i2", processor).reshape(num_frames, -1, 4)
    points = words[..., :3] * np.float32(1.0 if header.scale < 0 else header.scale)
    points[(words[..., 3] < 0) | (points == 0).all(-1)] = np.nan
    poses = _poses(content, groups, num_frames, processor)
    first_frame = header.first_frame - 1
    return C3dContent(groups, rate_hz, num_frames, ratio, samples, events, first_frame, points, poses)


def _poses(content: bytes, groups: Groups, num_frames: int, processor: int) -> np.ndarray:
    """Poses of segments at the frames: a block of its own, with a matrix by columns and its reliability."""
    facts = {name: int(np.ravel(value)[0]) for name, value in groups.get("ROTATION", {}).items() if name in _OF_POSES}
    used, ratio = facts.get("USED", 0), max(facts.get("RATIO", 1), 1)
    first = (facts.get("DATA_START", 0) - 1) * BLOCK_BYTES
    size = num_frames * ratio * used * 17 * 4
    if not used or first < BLOCK_BYTES or len(content) < first + size:
        return np.full((num_frames, 0, 4, 4), np.nan, "f4")
    numbers = _numbers(content[first : first + size], "f4", processor).reshape(num_frames, ratio, used, 17)[:, 0]
    poses = np.swapaxes(numbers[..., :16].reshape(num_frames, used, 4, 4), -1, -2).copy()
    poses[numbers[..., 16] < 0] = np.nan
    return poses


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
