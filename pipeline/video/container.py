"""Open an untrusted video and decode it from a keyframe on.

FFmpeg may open container formats only, and no other file. Decoding uses one thread. The module does not
import NumPy, so that decoder processes start quickly.
"""

import math
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import av
from av.container import InputContainer
from av.error import FFmpegError
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from pipeline.video.stamps import read_packets

# A playlist or a concat script would make FFmpeg open other files or addresses.
_OPTIONS = {"format_whitelist": "mov,matroska,avi,mpegts,mpeg", "protocol_whitelist": "file"}

# After a seek in an MPEG program stream, FFmpeg computes wrong frame times.
_NEVER_SEEK = frozenset({"mpeg"})

CODECS = frozenset({"h264", "hevc", "av1", "vp8", "vp9", "mpeg4", "mpeg2video", "mjpeg", "prores", "dnxhd", "ffv1"})
# Codecs whose frames state exactly whether others refer to them. In layers of HEVC such a frame may be referred to.
_MARKS_REFERENCES = frozenset({"h264"})

MAX_PIXELS = 8192 * 4320
"""Limit on the pixels of a picture; decoders refuse larger pictures before they allocate memory."""

# All exceptions that PyAV raises for a broken file.
DECODE_ERRORS = (FFmpegError, OSError, ValueError, EOFError)

# Computing time for reading the packets of a file.
_CPU_S_PER_BYTE = 60 / 2**30


def reading_s(path: Path) -> int:
    """Additional computing time (s) for reading a large file."""
    return math.ceil(path.stat().st_size * _CPU_S_PER_BYTE)


@contextmanager
def open_container(path: Path) -> Iterator[InputContainer]:
    """Open a video file; raises one of ``DECODE_ERRORS`` if FFmpeg can't open it."""
    # Without the prefix, FFmpeg would read a file name 'concat:...' as a protocol.
    with av.open(f"file:{path.absolute()}", options=_OPTIONS) as container:
        yield container


def first_video(container: InputContainer) -> VideoStream | None:
    """Return the first video stream with a decoder, set to one thread; ``None`` if there is no such stream."""
    for stream in container.streams.video:
        if stream.codec_context is not None:
            stream.codec_context.thread_count = 1
            stream.codec_context.options = {"max_pixels": str(MAX_PIXELS)}
            return stream
    return None


def decode_from(
    path: Path, seek_pts: Sequence[int], target_pts: int, wanted_pts: Collection[int] | None = None
) -> Iterator[VideoFrame]:
    """Decode frames in the order of display, from a keyframe that is not after ``target_pts``.

    Packets that can't be decoded are skipped, and their frames are missing.

    ``seek_pts``: timestamps of keyframes to start at, the best first. A seek may lead past the keyframe (damaged index,
    MPEG-TS), or to a frame that is wrongly marked as a keyframe. Then the next timestamp is tried, and finally the
    start of the file. An MPEG program stream is always decoded from its start. ``wanted_pts``: timestamps of the wanted
    frames; others may be missing. ``None``: all are wanted. Raises ``DECODE_ERRORS`` if the file can't be opened or
    read.
    """
    for keyframe_pts in seek_pts:
        with open_container(path) as container:
            frames = _decode_after_seek(container, keyframe_pts, wanted_pts)
            first = next(frames, None)
            if first is not None and first.key_frame and _is_shown_by(first, target_pts):
                yield first
                yield from frames
                return
    with open_container(path) as container:
        yield from _decode(container, first_video(container), wanted_pts=wanted_pts)


def decode_keyframes(path: Path, wanted_pts: Collection[int]) -> Iterator[VideoFrame]:
    """Decode some keyframes in the order of display, and no other frame.

    Frames of ``wanted_pts`` that can't be decoded are missing. Raises ``DECODE_ERRORS`` if the file can't be opened or
    read.
    """
    with open_container(path) as container:
        yield from _decode(container, first_video(container), frozenset(wanted_pts))


def display_pts(frame: VideoFrame) -> int | None:
    """Presentation timestamp of a frame in ticks of the stream's time base; ``None`` if it has none."""
    return frame.dts if frame.pts is None else frame.pts


def _is_shown_by(frame: VideoFrame, pts: int) -> bool:
    """Return whether a frame is shown at a timestamp or before it; False for a frame without a timestamp."""
    shown_pts = display_pts(frame)
    return shown_pts is not None and shown_pts <= pts


def _decode_after_seek(container: InputContainer, pts: int, wanted_pts: Collection[int] | None) -> Iterator[VideoFrame]:
    if container.format.name in _NEVER_SEEK:
        return
    stream = first_video(container)
    try:
        container.seek(pts, stream=stream)
    except DECODE_ERRORS:  # no usable index
        return
    yield from _decode(container, stream, wanted_pts=wanted_pts)


def _decode(
    container: InputContainer,
    stream: VideoStream | None,
    only_pts: Collection[int] | None = None,
    wanted_pts: Collection[int] | None = None,
) -> Iterator[VideoFrame]:
    """Decode the frames of a stream: of all packets, or of those with ``only_pts``.

    Of frames that are not in ``wanted_pts`` those are left out that no other frame refers to.
    """
    if stream is None:
        return
    leaves_out = wanted_pts is not None and stream.codec_context.name in _MARKS_REFERENCES
    for packet in read_packets(container, stream):
        # An empty packet ends the stream: the decoder gives the frames that it holds back.
        stamp = packet.dts if packet.pts is None else packet.pts
        if only_pts is not None and packet.size and stamp not in only_pts:
            continue
        if leaves_out:
            is_left_out = packet.size and packet.pts is not None and packet.pts not in (wanted_pts or ())
            stream.codec_context.skip_frame = "NONREF" if is_left_out else "DEFAULT"
        try:
            frames = packet.decode()
        except MemoryError:
            raise
        except DECODE_ERRORS:
            continue
        yield from frames
