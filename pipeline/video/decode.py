"""Decode exactly the requested range of frames, wherever the ranges are cut.

Each range is decoded in a child process with limits on memory and time, which works ahead by a frame or two.
"""

import json
import mmap
import os
import select
import subprocess
import sys
import tempfile
from bisect import bisect_left
from collections.abc import Callable, Collection, Generator, Iterator, Sequence
from contextlib import closing, suppress
from math import ceil
from pathlib import Path
from typing import IO, NamedTuple, cast

import numpy as np
from jaxtyping import UInt8

from pipeline.core.errors import InputError, Problem
from pipeline.core.problems.code_group import Code
from pipeline.core.problems.session_codes import VIDEO_CHANGES_SIZE, VIDEO_DAMAGED, VIDEO_TIMES, VIDEO_UNREADABLE
from pipeline.core.runtime import confinement
from pipeline.core.runtime.child_processes import module_command
from pipeline.video.decode_process import FRAME, Request
from pipeline.video.info import VideoInfo, seek_points
from pipeline.video.rotation import Rotator

# Longest wait for one frame. It includes decoding from the keyframe before the range. It is less than a minute, so
# that a job never seems to hang.
_TIMEOUT_S = 45.0


class DecodedFrame(NamedTuple):
    """A decoded frame."""

    pts: int  # Presentation timestamp, in ticks of the stream's time base
    size_px: tuple[int, int]  # Width and height, before rotation
    is_damaged: bool  # True if the decoder marks it as damaged
    # Read-only picture, valid until the next frame is requested. ``None`` outside the range, and for a picture whose
    # size differs from the request.
    image_rgb: UInt8[np.ndarray, "height width 3"] | None


def decoded_frames(request: Request, timeout_s: float | None = None) -> Generator[DecodedFrame, None, None]:
    """Decode frames in a child process.

    Close the generator if it is not read to its end: that ends the process.

    ``timeout_s``: longest wait for one frame; ``None``: 45 s. Raises ``FileRefusedError`` if the file can't be opened
    or read. Raises ``BeyondLimitsError`` if the decoder crashes, or exceeds the limits on time and memory. Raises
    ``ChildError`` if the process fails for a reason other than its file.
    """
    with _shared_file() as shared:
        shared.truncate(request.picture_bytes)
        picture = mmap.mmap(shared.fileno(), request.picture_bytes, access=mmap.ACCESS_READ)
        command = module_command("pipeline.video.decode_process", json.dumps(request._asdict()), str(shared.fileno()))
        with confinement.started_child(command, subprocess.PIPE, [shared.fileno()]) as (child, errors):
            yield from _read_frames(child, request, picture, errors, _TIMEOUT_S if timeout_s is None else timeout_s)


def _shared_file() -> IO[bytes]:
    """Open an anonymous file, in memory where the system supports it."""
    if sys.platform == "linux":
        return os.fdopen(os.memfd_create("multicap-picture"), "w+b")
    return tempfile.TemporaryFile()


def _read_frames(
    child: "subprocess.Popen[bytes]", request: Request, picture: mmap.mmap, errors: IO[bytes], timeout_s: float
) -> Iterator[DecodedFrame]:
    stdin, stdout = (cast(IO[bytes], pipe).fileno() for pipe in (child.stdin, child.stdout))
    image_rgb = np.frombuffer(picture, np.uint8).reshape(request.height, request.square_width, 3)
    is_ready, is_ended = False, False
    with suppress(TimeoutError):
        is_ready = _read(stdout, len(confinement.READY), timeout_s) == confinement.READY
        while is_ready and len(record := _read(stdout, FRAME.size, timeout_s)) == FRAME.size:
            pts, width, height, is_damaged, has_picture = FRAME.unpack(record)
            yield DecodedFrame(pts, (width, height), is_damaged, image_rgb if has_picture else None)
            if has_picture:
                with suppress(BrokenPipeError):  # the decoder has ended after its last picture
                    os.write(stdin, b"\n")
        is_ended = True
    end = confinement.child_end(child, timeout_s if is_ended else None, is_ready, errors)
    confinement.check_end(end, f"decoder of {Path(request.path).name}", timeout_s)


def _read(pipe: int, num_bytes: int, timeout_s: float) -> bytes:
    """Read bytes from a pipe, fewer at its end; raise ``TimeoutError`` if they don't arrive in time."""
    poll = select.poll()
    poll.register(pipe, select.POLLIN)
    content = b""
    while len(content) < num_bytes:
        if not poll.poll(1000 * timeout_s):
            raise TimeoutError
        if not (more := os.read(pipe, num_bytes - len(content))):
            break
        content += more
    return content


# Base limit on computing time, and additional time for each frame since the start of the file, where decoding may have
# to begin.
_MAX_CPU_S = 110
_MAX_CPU_S_PER_FRAME = 1


def decode(
    video: VideoInfo,
    start_frame: int,
    stop_frame: int,
    on_damaged: Callable[[int], object] = lambda _: None,
    only: Collection[int] | None = None,
    limit_s: float | None = None,
) -> Generator[tuple[int, UInt8[np.ndarray, "height width 3"]], None, None]:
    """Decode the frames ``start_frame <= k < stop_frame``, in order.

    Close the generator if it is not read to its end: that ends its child process.

    - ``on_damaged``: called with the number of each wanted frame that the decoder marks as damaged, or that it could
      not decode.
    - ``only``: numbers of the wanted frames of the range; ``None``: all. If all of them are keyframes, no other frame
      is decoded.
    - ``limit_s``: limit on the computing time, and on the wait for one frame; ``None``: enough for any range of a good
      file.
    - Yields number and RGB picture of each frame, mirrored and rotated for display. A picture is valid until the next
      frame is requested: all pictures share their memory.
    - Raises ``InputError`` if the file can't be read, if its decoder crashes or exceeds the limits on time or memory,
      if the size of the pictures changes, or if the timestamps go backwards.
    - Raises ``ChildError`` if the child process fails for a reason other than the file.
    """
    if video.parts:
        yield from _decode_parts(video, start_frame, stop_frame, on_damaged, only, limit_s)
        return
    wanted: Sequence[int] = range(max(start_frame, 0), min(stop_frame, video.num_frames))
    if only is not None:
        wanted = [number for number in sorted(set(only)) if number in wanted]
    if not wanted:
        return
    following, rotate = wanted[0], Rotator()
    try:
        request = _request(video, wanted, only is not None, limit_s)
        with closing(decoded_frames(request, limit_s)) as frames:
            previous_pts = None
            for frame in frames:
                if frame.size_px != video.stored_size_px:
                    raise _changed_size(video, following, frame.size_px)
                if previous_pts is not None and frame.pts < previous_pts:
                    raise _times_go_back(video, following)
                previous_pts = frame.pts
                number = _number(video, frame.pts)
                if frame.image_rgb is None or number is None or number < following:
                    continue
                for missing in _between(wanted, following, number):
                    on_damaged(missing)
                if frame.is_damaged:
                    on_damaged(number)
                following = number + 1
                yield number, rotate(frame.image_rgb, video.rotation_deg // 90, video.is_mirrored)
    except confinement.FileRefusedError:
        raise _undecodable(video, following) from None
    except confinement.BeyondLimitsError:
        raise _beyond_limits(video, following) from None
    for missing in _between(wanted, following, wanted[-1] + 1):
        on_damaged(missing)


def _decode_parts(
    video: VideoInfo,
    start_frame: int,
    stop_frame: int,
    on_damaged: Callable[[int], object],
    only: Collection[int] | None,
    limit_s: float | None,
) -> Generator[tuple[int, UInt8[np.ndarray, "height width 3"]], None, None]:
    """Decode the frames of a range from the files that have them."""
    first = 0
    for part in video.parts:
        last = first + part.num_frames
        if start_frame < last and stop_frame > first:
            numbers = None if only is None else [number - first for number in only if first <= number < last]

            def on_part_damaged(number: int, first: int = first) -> None:
                on_damaged(first + number)

            frames = decode(part, start_frame - first, stop_frame - first, on_part_damaged, numbers, limit_s)
            with closing(frames):
                for number, image_rgb in frames:
                    yield first + number, image_rgb
        first = last


def _between(wanted: Sequence[int], start: int, stop: int) -> Sequence[int]:
    """Wanted frames of the range ``start <= k < stop``."""
    return wanted[bisect_left(wanted, start) : bisect_left(wanted, stop)]


def _request(video: VideoInfo, wanted: Sequence[int], is_selection: bool, limit_s: float | None) -> Request:
    width, height = video.stored_size_px
    first_pts = int(video.pts[wanted[0]])
    only_pts = video.pts[list(wanted)].tolist() if is_selection else None
    max_cpu_s = _MAX_CPU_S + _MAX_CPU_S_PER_FRAME * (wanted[-1] + 1) if limit_s is None else ceil(limit_s)
    return Request(
        path=str(video.path.absolute()),
        codec=video.codec,
        width=width,
        height=height,
        square_width=video.unrotated_size_px[0],
        seek_pts=seek_points(video.keyframe_pts, first_pts),
        first_pts=first_pts,
        last_pts=int(video.pts[wanted[-1]]),
        to_the_end=wanted[-1] + 1 == video.num_frames,
        max_cpu_s=max_cpu_s,
        only_pts=only_pts,
        only_keyframes=only_pts is not None and bool(np.isin(only_pts, video.keyframe_pts).all()),
    )


def _number(video: VideoInfo, pts: int) -> int | None:
    """Frame number by timestamp; ``None`` for a picture that is not part of the display."""
    number = int(np.searchsorted(video.pts, pts))
    return number if number < video.num_frames and video.pts[number] == pts else None


def _changed_size(video: VideoInfo, number: int, size_px: tuple[int, int]) -> InputError:
    (width, height), (new_width, new_height) = video.stored_size_px, size_px
    return _bad_video(
        video,
        VIDEO_CHANGES_SIZE,
        f"The pictures change their size from {width} x {height} to {new_width} x {new_height} pixels, at or before "
        f"frame {number}.",
        "Cut the video there.",
    )


def _times_go_back(video: VideoInfo, number: int) -> InputError:
    message = f"The timestamps go backwards at or before frame {number}."
    return _bad_video(video, VIDEO_TIMES, message, "Export the video again.")


def _undecodable(video: VideoInfo, number: int) -> InputError:
    message = f"Frame {number} of {video.num_frames} can't be decoded."
    return _bad_video(video, VIDEO_DAMAGED, message, "Copy the file again, or cut it before that frame.")


def _beyond_limits(video: VideoInfo, number: int) -> InputError:
    message = f"Frame {number} of {video.num_frames} could not be decoded within the limits on time and memory."
    return _bad_video(video, VIDEO_UNREADABLE, message, "Convert the video to H.264 in MP4.")


def _bad_video(video: VideoInfo, code: Code, message: str, hint: str) -> InputError:
    return InputError([Problem(code, message, file=video.path.name, hint=hint)])
