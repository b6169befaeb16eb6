"""Look into video files, in a process of its own: ``python -m pipeline.video.probe FILE``.

Reads all packets and decodes the first and the last pictures; the frames between are decoded once, when they are used.
"""

import json
import math
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.child_processes import module_command, uninterrupted
from pipeline.errors import ChildError, Problem
from pipeline.video.container import CODECS, DECODE_ERRORS, first_video, open_container
from pipeline.video.info import VideoInfo
from pipeline.video.signatures import is_container

MAX_PIXELS = 8192 * 4320
MAX_FRAMES = 2_000_000
# Differences of 64 bit timestamps are exact below.
_MAX_TICKS = 2**62

# Of the usual interval: 3 ticks are like 2, a dropped frame is not.
_EVEN = 0.6

# Of a small file. A large one gets as much more as reading needs: its packets are read, its pictures are not decoded.
_TIMEOUT_S = 120.0
_MAX_CPU_S = 8
_CPU_S_PER_BYTE = 60 / 2**30
_MAX_MEMORY_BYTES = 4 * 2**30
_CHILDREN_AT_ONCE = 2

# The child's first line, before it opens the file: whatever ends it earlier is not the file's doing.
_READY = b"ready\n"
# Signals by which a decoder or a limit ends a process. Any other signal comes from outside.
_BY_THE_FILE = {-signal.SIGABRT, -signal.SIGBUS, -signal.SIGFPE, -signal.SIGILL, -signal.SIGSEGV, -signal.SIGXCPU}
_LOGGED_CHARACTERS = 2000


class _UnusableError(Exception):
    """A file that can't be used, and why."""

    def __init__(self, code: str, message: str, hint: str | None = None) -> None:
        super().__init__(code)
        self.code, self.message, self.hint = code, message, hint

    def problem(self, path: Path) -> Problem:
        """Problem of a file."""
        return Problem(self.code, self.message, file=path.name, hint=self.hint)


def probe(path: Path) -> VideoInfo | Problem:
    """Look into one file, in this process.

    Returns
    -------
        What is known of the video, or why it can't be used.
    """
    try:
        return _probe(path)
    except _UnusableError as error:
        return error.problem(path)
    except DECODE_ERRORS:
        return _unreadable().problem(path)


def _unreadable() -> _UnusableError:
    return _UnusableError(
        "video_unreadable",
        "This is no video that can be read, or it is damaged.",
        "A recording that was not closed has no index: record or export it again.",
    )


def _check_start(path: Path) -> None:
    """Raise ``_UnusableError`` for what can be told without opening a container."""
    if not path.is_file():
        raise _UnusableError("video_missing", "There is no such video file.")
    if path.stat().st_size == 0:
        raise _UnusableError("video_empty", "The file is empty.", "Copy it again.")
    if not is_container(path):
        raise _unreadable()


def _probe(path: Path) -> VideoInfo:
    _check_start(path)
    with open_container(path) as container:
        stream = first_video(container)
        if stream is None:
            raise _UnusableError(
                "no_video_stream", "The file has no video stream that can be decoded.", "Is it audio only?"
            )
        codec = stream.codec_context.codec.canonical_name
        if codec not in CODECS:
            raise _UnusableError(
                "unsupported_codec",
                f"The codec {codec} is not supported.",
                f"Convert it to one of {', '.join(sorted(CODECS))}.",
            )
        if stream.codec_context.width * stream.codec_context.height > MAX_PIXELS:
            raise _UnusableError("video_too_large", f"The picture has more than {MAX_PIXELS} pixels.", "Scale it down.")
        announced, time_base = stream.frames, stream.time_base
        pts, keyframe_pts = _read_packets(container, stream)
    if time_base is None or not len(pts):
        raise _UnusableError("no_frames", "The video has no frames.", "Record or export it again.")
    if not len(keyframe_pts):
        raise _UnusableError(
            "no_keyframes", "The video has no frame at which decoding can start.", "Record or export it again."
        )
    if int(pts[-1]) - int(pts[0]) > _MAX_TICKS:
        raise _UnusableError("video_times", "The times of the frames make no sense.", "Record or export it again.")
    if announced > len(pts) + 1:
        raise _UnusableError(
            "video_truncated", f"The file breaks off: {len(pts)} of {announced} frames are there.", "Copy it again."
        )
    size_px, rotation_deg = _decode_ends(path, keyframe_pts)
    time_s = (pts - pts[0]) * float(time_base)
    return VideoInfo(path, codec, size_px, rotation_deg, pts, keyframe_pts, time_s, mean_rate_hz(time_s))


def _read_packets(container: Any, stream: Any) -> tuple[np.ndarray, np.ndarray]:
    """Timestamps of all frames that will be shown, and of the keyframes, without decoding."""
    pts: list[int] = []
    keyframes: list[int] = []
    for packet in container.demux(stream):
        if packet.size == 0 or packet.is_discard:
            continue
        stamp = packet.dts if packet.pts is None else packet.pts
        if packet.is_corrupt or stamp is None:
            raise _UnusableError("video_truncated", f"The file breaks off after {len(pts)} frames.", "Copy it again.")
        pts.append(stamp)
        if packet.is_keyframe:
            keyframes.append(stamp)
        if len(pts) > MAX_FRAMES:
            raise _UnusableError("video_too_long", f"The video has more than {MAX_FRAMES} frames.", "Cut it.")
    return np.unique(np.array(pts, np.int64)), np.unique(np.array(keyframes, np.int64))


def _decode_ends(path: Path, keyframe_pts: np.ndarray) -> tuple[tuple[int, int], int]:
    """Decode the first picture, and one near the end, for size and rotation and to see that both can be had."""
    with open_container(path) as container:
        stream = first_video(container)
        first = next(container.decode(video=0), None)
        if first is None:
            raise _UnusableError("no_frames", "No frame of the video can be decoded.", "Record or export it again.")
        if len(keyframe_pts) > 1:
            container.seek(int(keyframe_pts[-1]), stream=stream)
            if next(container.decode(video=0), None) is None:
                raise _UnusableError("video_truncated", "The end of the video can't be decoded.", "Copy it again.")
    rotation_deg = round(first.rotation / 90) * 90 % 360
    size_px = (first.width, first.height) if rotation_deg % 180 == 0 else (first.height, first.width)
    return size_px, rotation_deg


def mean_rate_hz(time_s: np.ndarray) -> float:
    """Mean rate over the intervals within 60 % of their median: uneven intervals average out, gaps don't count.

    25 for a single frame, which has no interval; infinity where frames share their times.
    """
    intervals_s = np.sort(np.diff(time_s))
    if not len(intervals_s):
        return 25.0
    # One that is there, never the mean of two: 24 Hz on a clock of 60 Hz have intervals of 2 and 3 ticks.
    usual_s = intervals_s[(len(intervals_s) - 1) // 2]
    mean_s = float(np.mean(intervals_s[np.abs(intervals_s - usual_s) <= _EVEN * usual_s]))
    return 1.0 / mean_s if mean_s > 0 else math.inf


def probe_in_children(paths: Sequence[Path]) -> list[VideoInfo | Problem]:
    """Look into files, each in a process of its own with limits on time and memory.

    A file that makes FFmpeg crash, hang or eat memory costs its own child only. No child is left when this returns or
    raises, an interruption included.

    Raises
    ------
    ChildError
        If a child can't do its work, for a reason that is not its file.
    """
    running: set[subprocess.Popen[bytes]] = set()
    with ThreadPoolExecutor(_CHILDREN_AT_ONCE) as pool:
        waiting: list[Future[VideoInfo | Problem]] = []
        try:
            with uninterrupted():
                waiting += [pool.submit(_probe_in_child, path, running) for path in paths]
            return [one.result() for one in waiting]
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            while not all(one.done() for one in waiting):
                for child in list(running):
                    child.kill()
                time.sleep(0.01)
            raise


def _probe_in_child(path: Path, running: set[subprocess.Popen[bytes]]) -> VideoInfo | Problem:
    try:
        _check_start(path)
    except _UnusableError as error:
        return error.problem(path)
    except OSError:
        return _unreadable().problem(path)
    child = subprocess.Popen(  # noqa: S603 (our own interpreter and module)
        module_command("pipeline.video.probe", str(path.absolute())),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    running.add(child)
    try:
        said, errors = child.communicate(timeout=_TIMEOUT_S + 2 * _more_s(path))
        exit_code: int | None = child.returncode
    except subprocess.TimeoutExpired:
        child.kill()
        said, errors = child.communicate()
        exit_code = None
    finally:
        running.remove(child)
    if not said.startswith(_READY) or (exit_code and exit_code not in _BY_THE_FILE):
        raise _child_error(exit_code, errors.decode(errors="replace"))
    if exit_code != 0:
        return _beyond_limits(path.name)
    found = json.loads(said.removeprefix(_READY))
    if "problem" in found:
        return Problem(**found["problem"])
    return VideoInfo(
        path=path,
        codec=found["codec"],
        size_px=(found["size_px"][0], found["size_px"][1]),
        rotation_deg=found["rotation_deg"],
        pts=np.array(found["pts"], np.int64),
        keyframe_pts=np.array(found["keyframe_pts"], np.int64),
        time_s=np.array(found["time_s"], np.float64),
        frame_rate_hz=found["frame_rate_hz"],
    )


def _more_s(path: Path) -> int:
    """Seconds that reading a file takes beyond those of a small one."""
    return math.ceil(path.stat().st_size * _CPU_S_PER_BYTE)


def _beyond_limits(name: str) -> Problem:
    return Problem(
        "video_unreadable",
        "The video could not be examined within the limits on time and memory.",
        file=name,
        hint="Convert it to H.264 in MP4.",
    )


def _child_error(exit_code: int | None, errors: str) -> ChildError:
    """Error of a child that failed for a reason that is not its file; the end of its stderr is a note of it."""
    if exit_code is None:
        ending, hint = (
            f"did not start within {_TIMEOUT_S:g} s",
            "See that the machine is not overloaded, and try again.",
        )
    elif exit_code < 0:
        ending = f"was ended by {signal.Signals(-exit_code).name}"
        hint = "See that there is memory enough (the system's log says), and try again."
    else:
        last = errors.strip().rpartition("\n")[2]
        ending, hint = f"ended with exit code {exit_code} ({last})", "If it happens again, install Multicap anew."
    error = ChildError(f"Multicap's own check of the videos failed, the videos are not at fault: it {ending}. {hint}")
    error.add_note(f"stderr of pipeline.video.probe:\n{errors[-_LOGGED_CHARACTERS:]}")
    return error


def main() -> None:
    """Print what is known of the file as one JSON object, after a line that says that the program could be loaded."""
    resource.setrlimit(resource.RLIMIT_AS, (_MAX_MEMORY_BYTES, _MAX_MEMORY_BYTES))
    # SIGXCPU at the first limit, which tells of the file; SIGKILL, which tells nothing, at the second.
    path = Path(sys.argv[1])
    cpu_s = _MAX_CPU_S + _more_s(path)
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s + 5))
    sys.stdout.buffer.write(_READY)
    sys.stdout.flush()
    try:
        found = probe(path)
    except MemoryError:
        found = _beyond_limits(path.name)
    if isinstance(found, Problem):
        answer: dict[str, Any] = {"problem": asdict(found)}
    else:
        answer = asdict(found) | {name: getattr(found, name).tolist() for name in ("pts", "keyframe_pts", "time_s")}
        del answer["path"]
    sys.stdout.write(json.dumps(answer) + "\n")


if __name__ == "__main__":
    main()
