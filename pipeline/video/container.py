"""Open a stranger's video: container formats only, this one file only, one thread."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import av
from av.container import InputContainer
from av.error import FFmpegError
from av.video.stream import VideoStream

# A playlist or a concat script would make FFmpeg open whatever it names.
_OPTIONS = {"format_whitelist": "mov,matroska,avi,mpegts,mpeg", "protocol_whitelist": "file"}

CODECS = frozenset({"h264", "hevc", "av1", "vp8", "vp9", "mpeg4", "mpeg2video", "mjpeg", "prores", "dnxhd", "ffv1"})

# All that a broken file makes PyAV raise.
DECODE_ERRORS = (FFmpegError, OSError, ValueError, EOFError)


@contextmanager
def open_container(path: Path) -> Iterator[InputContainer]:
    """Open a video file; raises one of ``DECODE_ERRORS`` if it is none."""
    # The prefix keeps a file called 'concat:...' from being taken for a protocol.
    with av.open(f"file:{path.absolute()}", options=_OPTIONS) as container:
        yield container


def first_video(container: InputContainer) -> VideoStream | None:
    """The first video stream, set to decode on one thread; ``None`` if there is none or no decoder for it."""
    for stream in container.streams.video:
        if stream.codec_context is not None:
            stream.codec_context.thread_count = 1
            return stream
    return None
