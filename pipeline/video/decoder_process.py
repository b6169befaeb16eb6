"""Run ``pipeline.video.decoder`` in a child process: its codec may crash, hang or exhaust memory."""

import json
import mmap
import os
import select
import subprocess
import sys
import tempfile
from collections.abc import Generator, Iterator
from contextlib import suppress
from pathlib import Path
from typing import IO, NamedTuple, cast

import numpy as np
from jaxtyping import UInt8

from pipeline.core.runtime.child_processes import module_command
from pipeline.core.runtime.confinement import READY, check_end, child_end, started_child
from pipeline.video.decoder import FRAME, Request

# Longest wait for one frame. It includes decoding from the keyframe before the range. It is less than a minute, so
# that a job never seems to hang.
_TIMEOUT_S = 45.0


class DecodedFrame(NamedTuple):
    """A decoded frame."""

    pts: int  # Presentation timestamp, in ticks of the stream's time base
    size_px: tuple[int, int]  # Width and height, before rotation
    is_damaged: bool  # Whether the decoder marks it as damaged
    # Read-only picture, valid until the next frame is requested. ``None`` outside the range, and for a picture whose
    # size differs from the request.
    image_rgb: UInt8[np.ndarray, "height width 3"] | None


def decoded_frames(request: Request, timeout_s: float | None = None) -> Generator[DecodedFrame, None, None]:
    """Decode frames in a child process.

    Close the generator if it is not read to its end: that ends the process.

    Parameters
    ----------
    timeout_s
        Longest wait for one frame; ``None``: 45 s.

    Raises
    ------
    FileRefusedError
        If the file can't be opened or read.
    BeyondLimitsError
        If the decoder crashes, or exceeds the limits on time and memory.
    ChildError
        If the process fails for a reason other than its file.
    """
    with _shared_file() as shared:
        shared.truncate(request.picture_bytes)
        picture = mmap.mmap(shared.fileno(), request.picture_bytes, access=mmap.ACCESS_READ)
        command = module_command("pipeline.video.decoder", json.dumps(request._asdict()), str(shared.fileno()))
        with started_child(command, subprocess.PIPE, [shared.fileno()]) as (child, errors):
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
        is_ready = _read(stdout, len(READY), timeout_s) == READY
        while is_ready and len(record := _read(stdout, FRAME.size, timeout_s)) == FRAME.size:
            pts, width, height, is_damaged, has_picture = FRAME.unpack(record)
            yield DecodedFrame(pts, (width, height), is_damaged, image_rgb if has_picture else None)
            if has_picture:
                with suppress(BrokenPipeError):  # the decoder has ended after its last picture
                    os.write(stdin, b"\n")
        is_ended = True
    end = child_end(child, timeout_s if is_ended else None, is_ready, errors)
    check_end(end, f"decoder of {Path(request.path).name}", timeout_s)


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
