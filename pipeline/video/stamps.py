"""Timestamps of a video stream's packets, where containers or FFmpeg state others than the pictures' times."""

from collections.abc import Iterator
from itertools import chain, islice
from pathlib import Path
from typing import Any

from av.container import InputContainer
from av.packet import Packet
from av.video.stream import VideoStream

# FFmpeg gives a packet of such a stream in AVI the time of the packet after it.
_SHOWN_AT_PLACE = frozenset({"h264", "hevc"})
_HEAD_BYTES = 2**16
# Packets after the first one that show the usual duration, and the share of it by which a dropped frame is told.
_NUM_USUAL, _WHOLE = 4, 0.03


def read_packets(container: InputContainer, stream: VideoStream) -> "Iterator[Packet[Any]]":
    """Packets of a stream, whose timestamps are the times at which their pictures are shown.

    AVI states no times: a picture is shown at the place of its packet, and dropped frames have places too. The first
    picture of a fragmented file is moved by ``early_start``.
    """
    packets = container.demux(stream)
    if container.format.name == "avi" and stream.codec_context.name in _SHOWN_AT_PLACE:
        for packet in packets:
            packet.pts = packet.dts
            yield packet
        return
    first = list(islice(packets, 1 + _NUM_USUAL))
    if first and first[0].pts is not None and first[0].pts == stream.start_time and starts_at_zero(container):
        first[0].pts += early_start([packet.duration or 0 for packet in first])
    yield from chain(first, packets)


def early_start(durations: list[int]) -> int:
    """Ticks by which the first picture is early, by the durations of the first packets.

    FFmpeg begins each track of a fragmented file without an edit list at 0, also where its sound begins before the
    pictures, as AAC does. The first packet then lasts longer, and all others are at their times. If it is longer by
    whole frames, these were dropped.
    """
    if len(durations) <= _NUM_USUAL or min(durations) <= 0 or max(durations[1:]) - min(durations[1:]) > 1:
        return 0
    usual = durations[1]
    excess = durations[0] - usual
    return excess if excess > 1 and abs(excess / usual - round(excess / usual)) > _WHOLE else 0


def starts_at_zero(container: InputContainer) -> bool:
    """Return whether a file is a fragmented MP4 whose header has no edit list."""
    if "mp4" not in container.format.name.split(","):
        return False
    with Path(container.name.removeprefix("file:")).open("rb") as file:
        head = file.read(_HEAD_BYTES)
    return b"mvex" in head and b"elst" not in head


def reordering_delay(container: InputContainer, stream: VideoStream) -> int:
    """Ticks by which the pictures of an AVI file with B-frames are later than the places of their packets.

    FFmpeg delays the pictures by what their decoder holds back. The sound, whose places are its times, is not delayed.
    Reads the first packet of an opened file.
    """
    if container.format.name != "avi":
        return 0
    first = next(read_packets(container, stream))
    container.seek(0)
    return 0 if first.pts is None or first.dts is None else first.pts - first.dts
