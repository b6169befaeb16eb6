"""Proxies of videos: small copies that browsers play.

Each is made by ``python -m pipeline.video.playback.proxy``, a confined program, from a ``ProxyRequest`` as JSON on
stdin. It writes a byte to stdout for each encoded frame.
"""

import json
import sys
from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from av.filter import Graph
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from pipeline.core.errors import InputError, Problem
from pipeline.core.problems.code_group import Code
from pipeline.core.problems.session_codes import VIDEO_DAMAGED, VIDEO_UNREADABLE
from pipeline.core.runtime import confinement
from pipeline.video.container import DECODE_ERRORS, decode_from, display_pts
from pipeline.video.playback.h264 import KEYFRAME_S, TICKS_A_SECOND, add_stream, even_size_px, open_video

if TYPE_CHECKING:  # without NumPy the program starts in half the time
    import numpy as np
    from numpy.typing import NDArray

    from pipeline.video.info import VideoInfo

LONG_SIDE_PX = 960
"""Longest side of a proxy's pictures; smaller videos keep their size."""

FRAME = b"."
"""Record written for an encoded frame."""

# Longest wait for a frame, and limits on computing time and size, as a base and for each frame.
_TIMEOUT_S = 45.0
_MAX_CPU_S, _MAX_CPU_S_A_FRAME = 110, 1
_MAX_BYTES, _MAX_BYTES_A_FRAME = 2**24, 2**18
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


def proxy_size_px(size_px: tuple[int, int]) -> tuple[int, int]:
    """Size of the pictures of a proxy: even numbers, the long side at most ``LONG_SIDE_PX``.

    >>> proxy_size_px((1920, 1080))
    (960, 540)
    """
    return even_size_px(size_px, LONG_SIDE_PX)


def make_proxy_in_child(
    video: "VideoInfo", time_s: "NDArray[np.float64]", target: Path, on_frame: Callable[[], object]
) -> None:
    """Write a small copy of a video that browsers play: H.264 in MP4, without sound, at the true times of the frames.

    ``time_s``: times of the video's frames, ascending; in the proxy the first is 0. ``on_frame``: called after each
    frame; an exception from it ends the child. Raises ``InputError`` if the video can't be decoded, or not within the
    limits on time, memory and size. Raises ``ChildError`` if the child fails for a reason other than its file.
    """
    width, height = proxy_size_px(video.unrotated_size_px)
    ticks = [round(tick) for tick in ((time_s - time_s[0]) * TICKS_A_SECOND).tolist()]
    request = ProxyRequest(
        paths=[str(path.absolute()) for path in video.paths],
        target=str(target.absolute()),
        width=width,
        height=height,
        is_mirrored=video.is_mirrored,
        rotation_deg=video.rotation_deg,
        pts=[part.pts.tolist() for part in video.parts or (video,)],
        ticks=ticks,
        keyframe_frames=max(1, round(KEYFRAME_S * video.frame_rate_hz)),
    )
    limits = confinement.ChildLimits(
        cpu_s=_MAX_CPU_S + _MAX_CPU_S_A_FRAME * video.num_frames,
        file_bytes=_MAX_BYTES + _MAX_BYTES_A_FRAME * video.num_frames,
    )
    try:
        confinement.run_confined(
            "pipeline.video.playback.proxy",
            [],
            limits,
            task="making of a proxy",
            timeout_s=_TIMEOUT_S,
            given=json.dumps(request._asdict()).encode(),
            on_output=lambda frames: [on_frame() for _ in frames],
        )
    except confinement.FileRefusedError:
        message = "No frame of the video can be decoded for a copy that browsers play."
        raise _bad_video(video, VIDEO_DAMAGED, message, "Copy the file again.") from None
    except confinement.BeyondLimitsError:
        message = "The copy that browsers play could not be made within the limits on time, memory and size."
        raise _bad_video(video, VIDEO_UNREADABLE, message, "Convert the video to H.264 in MP4.") from None


def _bad_video(video: "VideoInfo", code: Code, message: str, hint: str) -> InputError:
    return InputError([Problem(code, message, file=video.path.name, hint=hint)])


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
        """True if a picture has the size and the format of the first one."""
        return (frame.width, frame.height, frame.format.name) == self._kind

    def convert(self, frame: VideoFrame) -> VideoFrame:
        """Scale and turn a picture."""
        self._graph.vpush(frame)
        return self._graph.vpull()


def main() -> int:
    """Make the proxy of the request and return the exit code."""
    confinement.confined_arguments()
    request = ProxyRequest(**json.load(sys.stdin))
    confinement.tell_ready()
    try:
        return 0 if write_proxy(request) else confinement.EXIT_REFUSED
    except MemoryError:
        return confinement.EXIT_OUT_OF_MEMORY
    except BrokenPipeError:  # the reader is gone
        return 1
    except DECODE_ERRORS:
        return confinement.EXIT_REFUSED


if __name__ == "__main__":
    sys.exit(main())
