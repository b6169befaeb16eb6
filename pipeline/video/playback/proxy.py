"""Make a proxy of a video: ``python -m pipeline.video.playback.proxy``, with a ``ProxyRequest`` as JSON on stdin.

The file is opened in this process alone, which has limits on memory, computing time and the size of what it writes. It
writes a byte to stdout for each encoded frame. The process ends when its parent does: nobody reads the bytes then.
"""

import json
import resource
import sys
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

from av.filter import Graph
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from pipeline.video.children import start_child
from pipeline.video.container import DECODE_ERRORS, decode_from, display_pts
from pipeline.video.playback.h264 import TICKS_A_SECOND, add_stream, open_video

EXIT_UNREADABLE = 3
EXIT_OUT_OF_MEMORY = 4

FRAME = b"."
"""What is written for an encoded frame."""

# Constant rate factor of x264.
_CRF = 26
_TURNS = {90: "transpose=cclock", 180: "hflip,vflip", 270: "transpose=clock"}


class ProxyRequest(NamedTuple):
    """A video, and the proxy to be made of it."""

    paths: Sequence[str]  # Paths of the video's files: of a recording in parts, several in order
    target: str  # Path of the proxy
    # Size of the proxy's pictures before rotation, even numbers
    width: int
    height: int
    # How the pictures are turned for display: mirrored first, then turned counterclockwise
    is_mirrored: bool
    rotation_deg: int
    pts: Sequence[Sequence[int]]  # Timestamps of the frames in each file, ascending
    ticks: Sequence[int]  # Times of all frames in the proxy, in ticks of ``TICKS_A_SECOND``, ascending
    keyframe_frames: int  # Number of frames from a keyframe to the next one
    # Limits on the computing time and on the size of the proxy
    max_cpu_s: int
    max_bytes: int


def write_proxy(request: ProxyRequest) -> int:
    """Write a proxy; returns the number of its frames. Frames that can't be decoded are missing."""
    num_frames, last_tick = 0, -1
    with open_video(Path(request.target)) as container:
        stream: VideoStream | None = None
        converter: _Converter | None = None
        for tick, frame in _frames(request):
            if tick <= last_tick:
                continue
            converter = converter or _Converter(frame, request)
            if not converter.fits(frame):
                continue
            picture = converter.convert(frame)
            size_px = picture.width, picture.height
            stream = stream or add_stream(container, size_px, request.ticks, request.keyframe_frames, _CRF)
            picture.pts, picture.time_base = tick, Fraction(1, TICKS_A_SECOND)
            container.mux(stream.encode(picture))
            num_frames, last_tick = num_frames + 1, tick
            sys.stdout.buffer.write(FRAME)
            sys.stdout.buffer.flush()
        if stream is not None:
            container.mux(stream.encode(None))
    return num_frames


def _frames(request: ProxyRequest) -> Iterator[tuple[int, VideoFrame]]:
    """Frames of all files with their times in the proxy, without pictures that are not part of the display."""
    first = 0
    for path, pts in zip(request.paths, request.pts, strict=True):
        for frame in decode_from(Path(path), [], pts[0]):
            if (shown_pts := display_pts(frame)) is None:
                continue
            number = bisect_left(pts, shown_pts)
            if number < len(pts) and pts[number] == shown_pts:
                yield request.ticks[first + number], frame
        first += len(pts)


class _Converter:
    """Scales and turns pictures of one size and format."""

    def __init__(self, frame: VideoFrame, request: ProxyRequest) -> None:
        self._kind = frame.width, frame.height, frame.format.name
        steps = [
            f"scale={request.width}:{request.height}:flags=bilinear:out_range=tv",
            *(["hflip"] if request.is_mirrored else []),
            *([_TURNS[request.rotation_deg]] if request.rotation_deg else []),
            "setsar=1",
            "format=yuv420p",
        ]
        self._graph = Graph()
        self._graph.threads = 1
        source = self._graph.add_buffer(
            width=frame.width, height=frame.height, format=frame.format, time_base=Fraction(1, TICKS_A_SECOND)
        )
        nodes = [source]
        for step in ",".join(steps).split(","):
            name, _, values = step.partition("=")
            nodes.append(self._graph.add(name, values or None))
        self._graph.link_nodes(*nodes, self._graph.add("buffersink")).configure()

    def fits(self, frame: VideoFrame) -> bool:
        """Whether a picture has the size and the format of the first one."""
        return (frame.width, frame.height, frame.format.name) == self._kind

    def convert(self, frame: VideoFrame) -> VideoFrame:
        """Scale and turn a picture."""
        self._graph.vpush(frame)
        return self._graph.vpull()


def main() -> int:
    """Make the proxy of the request and return the exit code."""
    request = ProxyRequest(**json.load(sys.stdin))
    resource.setrlimit(resource.RLIMIT_FSIZE, (request.max_bytes, request.max_bytes))
    start_child(request.max_cpu_s)
    try:
        return 0 if write_proxy(request) else EXIT_UNREADABLE
    except MemoryError:
        return EXIT_OUT_OF_MEMORY
    except BrokenPipeError:  # the reader is gone
        return 1
    except DECODE_ERRORS:
        return EXIT_UNREADABLE


if __name__ == "__main__":
    sys.exit(main())
