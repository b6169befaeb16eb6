"""Decode a range of a video's frames for another process.

``python -m pipeline.video.decode_process REQUEST FILE_DESCRIPTOR`` writes a record (``FRAME``) to stdout for each
decoded frame, in the order of display, from the keyframe before the range on. The picture of a frame in the range is
written to a file that both processes share. A byte on stdin confirms that the picture was read; then the next picture
may overwrite it. The process ends when stdin is closed.
"""

import json
import mmap
import os
import struct
import sys
import threading
from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import av
import av.logging
from av.filter import Graph
from av.video.frame import VideoFrame

from pipeline.core.errors import UnusableError
from pipeline.core.runtime.confinement import EXIT_OUT_OF_MEMORY, EXIT_REFUSED, ChildLimits, confine, tell_ready
from pipeline.video.container import DECODE_ERRORS, decode_from, decode_keyframes, display_pts
from pipeline.video.images.files import SEQUENCE
from pipeline.video.images.frames import decode_images, wanted_images

FRAME = struct.Struct("<qII??")
"""Timestamp, width, height, whether the decoder marks the frame as damaged, and whether there is a picture."""

# Codecs that replace damaged parts by the previous frame and report this only in the log.
_LOGS_DAMAGE = frozenset({"ffv1"})


class Request(NamedTuple):
    """A range of frames to decode."""

    # Path of the file, and FFmpeg's name of its codec
    path: str
    codec: str
    # Size of the stored pictures in pixels, before rotation. Frames of another size come without a picture.
    width: int
    height: int
    square_width: int  # Width of the pictures with square pixels
    seek_pts: Sequence[int]  # See ``decode_from``
    # Timestamps of the first and the last frame of the range
    first_pts: int
    last_pts: int
    to_the_end: bool  # True if to decode the frames after the range too, without their pictures
    max_cpu_s: int  # Limit on the computing time of the process
    # Timestamps of the frames whose pictures are wanted; ``None``: all frames of the range
    only_pts: Sequence[int] | None = None
    only_keyframes: bool = False  # True if ``only_pts`` are keyframes, so that no other frame needs to be decoded

    @property
    def picture_bytes(self) -> int:
        """Bytes of a picture and of the shared file, three a pixel."""
        return 3 * self.square_width * self.height


def _write_frames(request: Request, shared_file: int) -> None:
    picture = mmap.mmap(shared_file, request.picture_bytes)
    is_free = threading.Semaphore(1)
    threading.Thread(target=_read_stdin, args=[is_free], daemon=True).start()
    av.logging.set_level(av.logging.ERROR)
    to_rgb: Graph | None = None
    only_pts = None if request.only_pts is None else frozenset(request.only_pts)
    with av.logging.Capture() as logged:
        for frame in _frames(request):
            is_damaged = frame.is_corrupt or (request.codec in _LOGS_DAMAGE and bool(logged))
            logged.clear()
            pts = display_pts(frame)
            if pts is None:
                continue
            is_wanted = request.first_pts <= pts <= request.last_pts and (only_pts is None or pts in only_pts)
            if is_wanted and (frame.width, frame.height) == (request.width, request.height):
                to_rgb = to_rgb or rgb_converter(frame, request.square_width)
                to_rgb.vpush(frame)
                rgb = to_rgb.vpull()
                is_free.acquire()
                write_rows(rgb, memoryview(picture))
            else:
                is_wanted = False
            sys.stdout.buffer.write(FRAME.pack(pts, frame.width, frame.height, is_damaged, is_wanted))
            sys.stdout.buffer.flush()
            if pts >= request.last_pts and not request.to_the_end:
                return


def _frames(request: Request) -> Iterator[VideoFrame]:
    path = Path(request.path)
    if request.codec == SEQUENCE:
        return decode_images(path, wanted_images(request.first_pts, request.last_pts, request.only_pts))
    if request.only_keyframes and request.only_pts is not None:
        return decode_keyframes(path, request.only_pts)
    only_pts = None if request.only_pts is None else frozenset(request.only_pts)
    return decode_from(path, request.seek_pts, request.first_pts, only_pts)


def _read_stdin(is_free: threading.Semaphore) -> None:
    while os.read(0, 1):
        is_free.release()
    os._exit(1)


def rgb_converter(frame: VideoFrame, square_width: int) -> Graph:
    """Build a converter for frames of this size and format: a filter graph, which reuses the memory of pictures."""
    is_square = frame.width == square_width
    graph = Graph()
    graph.threads = 1
    source = graph.add_buffer(
        width=frame.width, height=frame.height, format=frame.format, time_base=frame.time_base or Fraction(1, 1)
    )
    scale = graph.add("scale", "flags=bilinear" if is_square else f"{square_width}:{frame.height}:flags=bicubic")
    rgb = graph.add("format", "pix_fmts=rgb24")
    return graph.link_nodes(source, scale, rgb, graph.add("buffersink"))


def write_rows(frame_rgb: VideoFrame, picture: memoryview) -> None:
    """Copy a picture to shared memory without the padding of its rows."""
    plane = frame_rgb.planes[0]
    rows, row_bytes = memoryview(plane), 3 * frame_rgb.width
    if plane.line_size == row_bytes:
        picture[:] = rows[: len(picture)]
        return
    for row in range(frame_rgb.height):
        start = row * plane.line_size
        picture[row * row_bytes : (row + 1) * row_bytes] = rows[start : start + row_bytes]


def main() -> int:
    """Write the frames of the request and return the exit code."""
    request, shared_file = Request(**json.loads(sys.argv[1])), int(sys.argv[2])
    confine(ChildLimits(request.max_cpu_s))
    tell_ready()
    try:
        _write_frames(request, shared_file)
    except MemoryError:
        return EXIT_OUT_OF_MEMORY
    except BrokenPipeError:  # the reader is gone
        return 1
    except (*DECODE_ERRORS, UnusableError):
        return EXIT_REFUSED
    return 0


if __name__ == "__main__":
    sys.exit(main())
