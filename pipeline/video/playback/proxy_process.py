"""Make proxies of videos, each in a child process (``pipeline.video.playback.proxy``) with limits."""

import json
import os
import select
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import IO, cast

import numpy as np
from jaxtyping import Float

from pipeline.core.errors import InputError, Problem
from pipeline.core.problems.model import Code
from pipeline.core.problems.sessions import VIDEO_DAMAGED, VIDEO_UNREADABLE
from pipeline.core.runtime.child_processes import module_command, uninterrupted
from pipeline.video.children import READY, child_error, is_caused_by_file
from pipeline.video.info import VideoInfo
from pipeline.video.playback.h264 import KEYFRAME_S, TICKS_A_SECOND, even_size_px
from pipeline.video.playback.proxy import EXIT_OUT_OF_MEMORY, EXIT_UNREADABLE, ProxyRequest

LONG_SIDE_PX = 960
"""Longest side of a proxy's pictures; smaller videos keep their size."""

# Longest wait for a frame, and limits on computing time and size, as a base and for each frame.
_TIMEOUT_S = 45.0
_MAX_CPU_S, _MAX_CPU_S_A_FRAME = 110, 1
_MAX_BYTES, _MAX_BYTES_A_FRAME = 2**24, 2**18
_READ_BYTES = 2**12


def proxy_size_px(size_px: tuple[int, int]) -> tuple[int, int]:
    """Size of the pictures of a proxy: even numbers, the long side at most ``LONG_SIDE_PX``.

    >>> proxy_size_px((1920, 1080))
    (960, 540)
    """
    return even_size_px(size_px, LONG_SIDE_PX)


def make_proxy_in_child(
    video: VideoInfo, time_s: Float[np.ndarray, " frames"], target: Path, on_frame: Callable[[], object]
) -> None:
    """Write a small copy of a video that browsers play: H.264 in MP4, without sound, at the true times of the frames.

    Parameters
    ----------
    time_s
        Times of the video's frames, ascending; in the proxy the first is 0.
    on_frame
        Called after each frame; an exception from it ends the child.

    Raises
    ------
    InputError
        If the video can't be decoded, or not within the limits on time, memory and size.
    ChildError
        If the child fails for a reason other than its file.
    """
    width, height = proxy_size_px(video.unrotated_size_px)
    ticks = np.rint((time_s - time_s[0]) * TICKS_A_SECOND).astype(np.int64)
    request = ProxyRequest(
        paths=[str(path.absolute()) for path in video.paths],
        target=str(target.absolute()),
        width=width,
        height=height,
        is_mirrored=video.is_mirrored,
        rotation_deg=video.rotation_deg,
        pts=[part.pts.tolist() for part in video.parts or (video,)],
        ticks=ticks.tolist(),
        keyframe_frames=max(1, round(KEYFRAME_S * video.frame_rate_hz)),
        max_cpu_s=_MAX_CPU_S + _MAX_CPU_S_A_FRAME * video.num_frames,
        max_bytes=_MAX_BYTES + _MAX_BYTES_A_FRAME * video.num_frames,
    )
    child: subprocess.Popen[bytes] | None = None
    with tempfile.TemporaryFile() as given, tempfile.TemporaryFile() as errors:
        given.write(json.dumps(request._asdict()).encode())
        given.seek(0)
        try:
            with uninterrupted():
                child = subprocess.Popen(  # noqa: S603 (our own interpreter and module)
                    module_command("pipeline.video.playback.proxy"),
                    stdin=given,
                    stdout=subprocess.PIPE,
                    stderr=errors,
                    bufsize=0,
                )
            _follow(child, video, on_frame, errors)
        finally:
            if child is not None:
                child.kill()
                with child:  # closes the pipe, and waits
                    pass


def _follow(
    child: "subprocess.Popen[bytes]", video: VideoInfo, on_frame: Callable[[], object], errors: IO[bytes]
) -> None:
    """Count the frames of a child to its end; raise the problem of one that failed."""
    stdout = cast(IO[bytes], child.stdout).fileno()
    poll = select.poll()
    poll.register(stdout, select.POLLIN)
    head, is_ended = b"", False
    while not is_ended and poll.poll(1000 * _TIMEOUT_S):
        content = os.read(stdout, _READ_BYTES)
        is_ended = not content
        if (missing := len(READY) - len(head)) > 0:
            head, content = head + content[:missing], content[missing:]
        for _ in content:
            on_frame()
    is_started = head == READY
    exit_code: int | None = None
    if is_ended:
        exit_code = child.wait(_TIMEOUT_S)
    if exit_code == 0 and is_started:
        return
    if exit_code == EXIT_UNREADABLE:
        message = "No frame of the video can be decoded for a copy that browsers play."
        raise _bad_video(video, VIDEO_DAMAGED, message, "Copy the file again.")
    if is_started and (exit_code is None or exit_code == EXIT_OUT_OF_MEMORY or is_caused_by_file(exit_code)):
        message = "The copy that browsers play could not be made within the limits on time, memory and size."
        raise _bad_video(video, VIDEO_UNREADABLE, message, "Convert the video to H.264 in MP4.")
    errors.seek(0)
    raise child_error("making of a proxy", exit_code, _TIMEOUT_S, errors.read().decode(errors="replace"))


def _bad_video(video: VideoInfo, code: Code, message: str, hint: str) -> InputError:
    return InputError([Problem(code, message, file=video.path.name, hint=hint)])
