"""First bytes of video files: what is no container of ours is told without opening it with FFmpeg."""

from pathlib import Path

_HEAD_BYTES = 2**16

# Types of atoms with which files of QuickTime and MP4 begin, as FFmpeg's mov_probe knows them.
_ATOMS = frozenset(
    b"ftyp moov moof mdat styp sidx free skip wide uuid udta meta pnot ediw junk pict prfl emsg prft".split()
)
_MATROSKA = b"\x1aE\xdf\xa3"
_AVI_FORMS = frozenset({b"AVI ", b"AVIX", b"AVI\x19"})
_MPEG_PACK = b"\x00\x00\x01\xba"

# Packets of a transport stream: plain, with a time before each, and with error correction behind each.
_PACKET_BYTES = (188, 192, 204)
_MIN_PACKETS = 4


def is_container(path: Path) -> bool:
    """Whether a file begins as MP4, QuickTime, Matroska, WebM, AVI, or MPEG streams do."""
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    return (
        head[4:8] in _ATOMS
        or head.startswith(_MATROSKA)
        or (head.startswith(b"RIFF") and head[8:12] in _AVI_FORMS)
        or _MPEG_PACK in head
        or any(_is_transport_stream(head, packet_bytes) for packet_bytes in _PACKET_BYTES)
    )


def _is_transport_stream(head: bytes, packet_bytes: int) -> bool:
    """Whether each of some packets in a row begins with the sync byte."""
    starts = range(min(packet_bytes, len(head) - (_MIN_PACKETS - 1) * packet_bytes))
    return any(head[start::packet_bytes][:_MIN_PACKETS] == b"G" * _MIN_PACKETS for start in starts)
