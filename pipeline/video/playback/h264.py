"""H.264 in MP4 as browsers play it: 8 bits, no B-frames, a keyframe every half second, the index in front."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path

import av
from av.container import OutputContainer
from av.video.stream import VideoStream

TICKS_A_SECOND = 90_000
"""Time base of the videos: multiples of common frame durations."""

KEYFRAME_S = 0.5
"""Time between keyframes. A player that seeks decodes from a keyframe."""

# Without B-frames, times begin at 0.
_CONTAINER_OPTIONS = {"movflags": "+faststart"}
_CODEC_OPTIONS = {"preset": "veryfast", "tune": "fastdecode", "profile": "main", "bf": "0"}


def even_size_px(size_px: tuple[int, int], long_side_px: int) -> tuple[int, int]:
    """Size of the pictures of a small copy: even numbers, the long side at most ``long_side_px``.

    >>> even_size_px((1920, 1080), 960)
    (960, 540)
    """
    scale = min(1.0, long_side_px / max(size_px))
    width, height = (max(2, 2 * round(scale * side / 2)) for side in size_px)
    return width, height


@contextmanager
def open_video(path: Path) -> Iterator[OutputContainer]:
    """Open an MP4 file to be written; it is whole after the block."""
    with av.open(f"file:{path}", "w", format="mp4", options=_CONTAINER_OPTIONS) as container:
        yield container


def add_stream(
    container: OutputContainer, size_px: tuple[int, int], ticks: Sequence[int], keyframe_frames: int, crf: int
) -> VideoStream:
    """Add a video stream whose encoder uses one thread.

    Width and height are even, and times of the frames ascend; ``keyframe_frames`` are from a keyframe to the next one.
    A higher constant rate factor ``crf`` of x264 is worse and smaller.
    """
    span = max(1, ticks[-1] - ticks[0])
    rate_hz = Fraction(max(1, len(ticks) - 1) * TICKS_A_SECOND, span).limit_denominator(1001)
    x264 = f"keyint={keyframe_frames}:min-keyint={keyframe_frames}:scenecut=0"
    options = _CODEC_OPTIONS | {"crf": str(crf), "x264-params": x264}
    stream = container.add_stream("libx264", rate=rate_hz, options=options)
    stream.width, stream.height = size_px
    stream.pix_fmt = "yuv420p"
    stream.codec_context.time_base = Fraction(1, TICKS_A_SECOND)
    stream.codec_context.thread_count = 1
    return stream
