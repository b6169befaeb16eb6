"""Recordings of LSL's streams as files of XDF, by its specification."""

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

_FILE_HEADER, _STREAM_HEADER, _SAMPLES, _CLOCK_OFFSET, _STREAM_FOOTER = 1, 2, 3, 4, 6


class RecordedStream(NamedTuple):
    """Stream as an inlet got it."""

    info_xml: str
    samples: Sequence[Sequence[Any]]  # Numbers of single precision, or texts
    stamps_s: Sequence[float]


def write_xdf(path: Path, streams: Sequence[RecordedStream]) -> None:
    """Write streams that were recorded together on one machine."""
    content = b"XDF:" + _chunk(_FILE_HEADER, b'<?xml version="1.0"?><info><version>1.0</version></info>')
    for number, stream in enumerate(streams, 1):
        head = struct.pack("<I", number)
        content += _chunk(_STREAM_HEADER, head + stream.info_xml.encode())
        samples = b"".join(map(_sample, stream.samples, stream.stamps_s))
        content += _chunk(_CLOCK_OFFSET, head + struct.pack("<2d", stream.stamps_s[0], 0.0))
        content += _chunk(_SAMPLES, head + struct.pack("<BI", 4, len(stream.samples)) + samples)
        footer = (
            f'<?xml version="1.0"?><info><first_timestamp>{stream.stamps_s[0]}</first_timestamp>'
            f"<last_timestamp>{stream.stamps_s[-1]}</last_timestamp><sample_count>{len(stream.samples)}</sample_count>"
            "</info>"
        )
        content += _chunk(_STREAM_FOOTER, head + footer.encode())
    path.write_bytes(content)


def _chunk(tag: int, content: bytes) -> bytes:
    return struct.pack("<BIH", 4, 2 + len(content), tag) + content


def _sample(values: Sequence[Any], stamp_s: float) -> bytes:
    encoded = [
        struct.pack("<BI", 4, len(value.encode())) + value.encode()
        if isinstance(value, str)
        else struct.pack("<f", value)
        for value in values
    ]
    return struct.pack("<Bd", 8, stamp_s) + b"".join(encoded)
