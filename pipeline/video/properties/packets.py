"""Packets of a video stream: times and keyframes of the frames, without decoding them."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from av.container import InputContainer
from av.packet import Packet
from av.video.stream import VideoStream
from numpy.typing import NDArray

from pipeline.core.errors import Problem, UnusableError
from pipeline.core.problems.finding_codes import SOUND_DELAY_UNKNOWN
from pipeline.core.problems.session_codes import VIDEO_TIMES, VIDEO_TOO_LONG, VIDEO_TRUNCATED
from pipeline.video.container import DECODE_ERRORS, open_container
from pipeline.video.stamps import read_packets

_AAC_SAMPLES = 1024


def unknown_delays(path: Path) -> list[Problem]:
    """Warn of AAC in MP4 or MOV whose encoder delay is not stated; reads the first packet of the first sound track.

    An edit list states the delay, and FFmpeg cuts it off. Fragmented files without one begin with the delay as sound.
    """
    try:
        with open_container(path) as container:
            streams = [stream for stream in container.streams.audio if stream.codec_context is not None]
            if "mp4" not in container.format.name.split(",") or not streams:
                return []
            stream = streams[0]
            first = next(container.demux(stream))
            # A sound that begins later, with its delay before it, is stated by an edit list too.
            is_stated = first.pts is None or first.pts < 0 or (first.pts > 0 and stream.frames > 0)
            if stream.codec_context.codec.canonical_name != "aac" or is_stated:
                return []
            delay_ms = 1000 * _AAC_SAMPLES / stream.codec_context.sample_rate
    except (*DECODE_ERRORS, StopIteration, ZeroDivisionError):
        return []
    return [
        Problem(
            SOUND_DELAY_UNKNOWN,
            f"The file does not state the delay of its AAC sound: the sound may be off by {delay_ms:.0f} ms or more.",
            hint="This concerns synchronisation by sound alone. An MP4 file that is not fragmented states the delay.",
        )
    ]


MAX_FRAMES = 2_000_000
# Longest span of timestamps in ticks: differences of 64-bit integers do not overflow below it.
_MAX_TICKS = 2**62

# Decoders reorder 16 frames at most. A frame farther from its place in the order of times has a wrong timestamp.
_MAX_REORDERED = 32
_MAX_REPEATED_SHARE = 0.1
REPAIR_TIMES = "Export it again at a constant frame rate."


class Packets(NamedTuple):
    """Frames of a stream in stored order."""

    pts: NDArray[np.int64]  # Timestamps of all frames to show, in ticks of the stream's time base
    keyframe_pts: NDArray[np.int64]  # Timestamps of the keyframes, ascending
    num_read: int  # Number of packets, also of frames that are not shown


def list_packets(container: InputContainer, stream: VideoStream) -> Packets:
    """Read all packets; raise ``UnusableError`` if one has no timestamp or the last one is cut off."""
    codec = stream.codec_context.codec.canonical_name
    pts: list[int] = []
    keyframes: list[int] = []
    is_corrupt = False
    num_read = 0
    for packet in read_packets(container, stream):
        num_read += packet.size > 0
        if packet.size == 0 or packet.is_discard or _is_hidden(codec, packet):
            continue
        stamp = packet.dts if packet.pts is None else packet.pts
        is_corrupt = packet.is_corrupt
        if stamp is None:
            raise UnusableError(VIDEO_TIMES, f"Frame {len(pts)} has no timestamp.", REPAIR_TIMES)
        pts.append(stamp)
        if packet.is_keyframe:
            keyframes.append(stamp)
        if len(pts) > MAX_FRAMES:
            raise UnusableError(VIDEO_TOO_LONG, f"The video has more than {MAX_FRAMES} frames.", "Cut it.")
    # Only the last packet counts: the decoder marks damaged frames before it.
    if is_corrupt:
        raise UnusableError(VIDEO_TRUNCATED, f"The file is truncated after {len(pts) - 1} frames.", "Copy it again.")
    return Packets(np.array(pts, np.int64), np.unique(np.array(keyframes, np.int64)), num_read)


def _is_hidden(codec: str, packet: "Packet[Any]") -> bool:
    """Return whether a packet is a VP8 frame without the bit ``show_frame`` (RFC 6386, section 9.1)."""
    return codec == "vp8" and not memoryview(packet)[0] & 0x10


def shown_pts(stored_pts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Sort timestamps in the order of display and remove repeated ones; raise if they are not plausible."""
    shown = np.unique(stored_pts)
    if int(shown[-1]) - int(shown[0]) > _MAX_TICKS:
        raise UnusableError(VIDEO_TIMES, "The timestamps of the frames are too far apart.", REPAIR_TIMES)
    num_repeated = len(stored_pts) - len(shown)
    if num_repeated > _MAX_REPEATED_SHARE * len(stored_pts):
        raise UnusableError(
            VIDEO_TIMES,
            f"{num_repeated} of {len(stored_pts)} frames have the timestamp of another frame.",
            REPAIR_TIMES,
        )
    order = np.argsort(stored_pts, kind="stable")
    misplaced = np.flatnonzero(np.abs(order - np.arange(len(order))) > _MAX_REORDERED)
    if len(misplaced):
        message = f"The timestamps go backwards near frame {misplaced[0]}."
        raise UnusableError(VIDEO_TIMES, message, REPAIR_TIMES)
    return shown
