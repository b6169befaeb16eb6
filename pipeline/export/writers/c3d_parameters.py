"""Header and parameters of C3D files (the format's description of 2021, c3d.org), little-endian, numbers as floats.

A file has a header of one block of 512 bytes, the blocks of parameters, and the blocks of data. A parameter has a
type, dimensions of a byte each, the first one the fastest, and its values. Lists of more than 255 items go on in
parameters of the same name with a number: ``LABELS``, ``LABELS2``, and so on.
"""

import struct
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

BLOCK_BYTES = 512
MAX_BLOCKS = 2**16 - 1
"""Largest number of a block that a parameter can state."""
_KEY, _INTEL, _FIRST_PARAMETERS = 0x50, 84, 2
_MAX_PARAMETER_BLOCKS, _MAX_ITEMS = 255, 255
_HEADER = struct.Struct("<BBHHHHHfHHf")
_TEXT, _WORD, _FLOAT = -1, 2, 4

Value = Sequence[str] | Sequence[int] | Sequence[float] | np.ndarray
Groups = Mapping[str, Mapping[str, Value]]
"""Values of parameters by group and name: texts, whole numbers of 16 bits, floats, or an array of floats by rows."""


class C3dHeader(NamedTuple):
    """Facts of a file's header."""

    num_points: int
    num_frames: int
    scale: float  # Negative: the scale of residuals; points are floats
    first_block: int  # First block of the points, counted from 1
    frame_rate_hz: float


def header_bytes(header: C3dHeader) -> bytes:
    """Header of a file; a number of frames beyond 16 bits is in the parameters alone."""
    last = min(header.num_frames, MAX_BLOCKS)
    packed = _HEADER.pack(
        _FIRST_PARAMETERS,
        _KEY,
        header.num_points,
        0,
        1,
        last,
        0,
        header.scale,
        header.first_block,
        0,
        header.frame_rate_hz,
    )
    return packed.ljust(BLOCK_BYTES, b"\0")


def read_header(content: bytes) -> C3dHeader:
    """Read a header of ``header_bytes``; the number of frames is at most 65,535."""
    _, _, num_points, _, first, last, _, scale, first_block, _, rate_hz = _HEADER.unpack_from(content)
    return C3dHeader(num_points, last - first + 1, scale, first_block, rate_hz)


def parameter_bytes(groups: Groups) -> bytes:
    """Blocks of the parameters.

    Raises
    ------
    ValueError
        If they need more than 255 blocks.
    """
    entries = [
        entry
        for number, (group, parameters) in enumerate(groups.items(), start=1)
        for entry in (_entry(group, -number, b""), *_entries_of(number, parameters))
    ]
    # Each entry states where the next one begins; the last one states 0.
    linked = [
        head + struct.pack("<H", len(rest) + 2 if number < len(entries) - 1 else 0) + rest
        for number, (head, rest) in enumerate(entries)
    ]
    content = bytes(4) + b"".join(linked)
    num_blocks = -(-len(content) // BLOCK_BYTES)
    if num_blocks > _MAX_PARAMETER_BLOCKS:
        raise ValueError(f"the parameters need {num_blocks} blocks")
    return bytes((1, _KEY, num_blocks, _INTEL)) + content[4:].ljust(num_blocks * BLOCK_BYTES - 4, b"\0")


def _entries_of(group: int, parameters: Mapping[str, Value]) -> Iterator[tuple[bytes, bytes]]:
    """Entries of a group's parameters; long lists go on in further ones."""
    for name, value in parameters.items():
        for start in range(0, max(len(value), 1), _MAX_ITEMS):
            part = value[start : start + _MAX_ITEMS]
            yield _entry(name if start == 0 else f"{name}{start // _MAX_ITEMS + 1}", group, _packed(part))


def _entry(name: str, number: int, content: bytes) -> tuple[bytes, bytes]:
    """Bytes before and after the offset of an entry, which ends with an empty description."""
    return struct.pack("<bb", len(name), number) + name.encode("ascii"), content + b"\0"


def _packed(value: Value) -> bytes:
    """Type, dimensions and values of a parameter."""
    if isinstance(value, np.ndarray):
        dimensions, code, content = value.shape[::-1], _FLOAT, value.astype("<f4").tobytes()
    elif all(isinstance(item, str) for item in value):
        texts = [str(item).encode("ascii", "replace")[:_MAX_ITEMS] for item in value]
        width = max(map(len, texts), default=0)
        dimensions, code, content = (width, len(texts)), _TEXT, b"".join(text.ljust(width) for text in texts)
    elif all(isinstance(item, int) for item in value):
        dimensions, code, content = (len(value),), _WORD, np.array(value, "<u2").tobytes()
    else:
        dimensions, code, content = (len(value),), _FLOAT, np.array(value, "<f4").tobytes()
    if dimensions == (1,):
        dimensions = ()
    return struct.pack(f"<bB{len(dimensions)}B", code, len(dimensions), *dimensions) + content


def read_numbers(content: bytes) -> dict[tuple[str, str], np.ndarray]:
    """Numbers in the blocks of ``parameter_bytes`` by group and name, each as a flat array."""
    names: dict[int, str] = {}
    numbers: dict[tuple[str, str], np.ndarray] = {}
    place, step = 4, 1
    while step:
        length, number = struct.unpack_from("<bb", content, place)
        name = content[place + 2 : place + 2 + length].decode("ascii")
        place += 2 + length
        (step,) = struct.unpack_from("<H", content, place)
        if number < 0:
            names[-number] = name
        else:
            code, num_dimensions = struct.unpack_from("<bB", content, place + 2)
            if code in (_WORD, _FLOAT):
                count = int(np.prod(list(content[place + 4 : place + 4 + num_dimensions]), initial=1))
                kind = "<u2" if code == _WORD else "<f4"
                numbers[names[number], name] = np.frombuffer(content, kind, count, place + 4 + num_dimensions)
        place += step
    return numbers
