"""Signatures and sizes of video files: other files are refused without opening them with FFmpeg."""

import struct
from pathlib import Path

_HEAD_BYTES = 2**16

# Types of the first atom of QuickTime and MP4 files, from FFmpeg's mov_probe.
_ATOMS = frozenset(
    b"ftyp moov moof mdat styp sidx free skip wide uuid udta meta pnot ediw junk pict prfl emsg prft".split()
)
_MATROSKA = b"\x1aE\xdf\xa3"
_DOC_TYPE = b"\x42\x82"  # id of the element DocType of the header
_MAX_EBML_HEADER_BYTES = 128
_AVI_FORMS = frozenset({b"AVI ", b"AVIX", b"AVI\x19"})
_MPEG_PACK = b"\x00\x00\x01\xba"

# Packet sizes of transport streams: plain, with a timestamp before each packet, with error correction after it.
_PACKET_BYTES = (188, 192, 204)
_MIN_PACKETS = 4


def is_container(path: Path) -> bool:
    """Return whether a file begins like MP4, QuickTime, Matroska, WebM, AVI, or an MPEG stream."""
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    return (
        head[4:8] in _ATOMS
        or head.startswith(_MATROSKA)
        or (head.startswith(b"RIFF") and head[8:12] in _AVI_FORMS)
        or _MPEG_PACK in head
        or any(_is_transport_stream(head, packet_bytes) for packet_bytes in _PACKET_BYTES)
    )


def document_type(path: Path) -> str:
    """Type of document that a Matroska file states, such as "webm"; empty for other files."""
    with path.open("rb") as file:
        head = file.read(_MAX_EBML_HEADER_BYTES)
    start = head.find(_DOC_TYPE)
    if not head.startswith(_MATROSKA) or start < 0 or len(head) <= start + len(_DOC_TYPE):
        return ""
    begin = start + len(_DOC_TYPE) + 1
    # The size of a short element is one byte with the highest bit set.
    length = head[begin - 1] & 0x7F
    return head[begin : begin + length].rstrip(b"\0").decode("ascii", "replace")


def is_cut_avi(path: Path) -> bool:
    """Return whether an AVI file ends before its last RIFF chunk does; a large file has several."""
    size, start = path.stat().st_size, 0
    with path.open("rb") as file:
        while start + 8 <= size:
            file.seek(start)
            kind, length = struct.unpack("<4sI", file.read(8))
            # A program that writes to a pipe leaves the length 0.
            if kind != b"RIFF" or length == 0:
                return False
            start += 8 + length
            if start > size:
                return True
            start += length % 2
    return False


def _is_transport_stream(head: bytes, packet_bytes: int) -> bool:
    """Return whether several packets in a row begin with the sync byte."""
    starts = range(min(packet_bytes, len(head) - (_MIN_PACKETS - 1) * packet_bytes))
    return any(head[start::packet_bytes][:_MIN_PACKETS] == b"G" * _MIN_PACKETS for start in starts)
