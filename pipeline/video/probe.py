"""Look into video files, in a process of its own: ``python -m pipeline.video.probe FILE``.

Reads all packets and decodes the first and the last pictures; the frames between are decoded once, when they are used.
"""

import json
import math
import sys
from dataclasses import asdict
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from av.container import InputContainer
from av.video.stream import VideoStream
from jaxtyping import Int

from pipeline.errors import Problem
from pipeline.video.children import start_child
from pipeline.video.container import (
    CODECS,
    DECODE_ERRORS,
    MAX_PIXELS,
    decode_from,
    first_video,
    open_container,
    shown_at,
)
from pipeline.video.frame_rate import measured_rate_hz
from pipeline.video.info import VideoInfo, seek_points
from pipeline.video.signatures import is_container

MAX_FRAMES = 2_000_000
# Differences of 64 bit timestamps are exact below.
_MAX_TICKS = 2**62

# Decoders hold back 16 frames at most to show them in order; frames that are further from their place are in disorder.
_MAX_REORDERED = 32
_MAX_REPEATED_SHARE = 0.1
_NUM_DECODED = 8
_REPAIR_TIMES = "Export it again at a constant frame rate."

# Of a small file. A large one gets as much more as reading needs: its packets are read, its pictures are not decoded.
_MAX_CPU_S = 8
_CPU_S_PER_BYTE = 60 / 2**30


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
        stored_pts, keyframe_pts = _read_packets(container, stream)
    if time_base is None or not len(stored_pts):
        raise _UnusableError("no_frames", "The video has no frames.", "Record or export it again.")
    if not len(keyframe_pts):
        raise _UnusableError(
            "no_keyframes", "The video has no frame at which decoding can start.", "Record or export it again."
        )
    if announced > len(stored_pts) + 1:
        raise _UnusableError(
            "video_truncated",
            f"The file breaks off: {len(stored_pts)} of {announced} frames are there.",
            "Copy it again.",
        )
    pts = _shown_pts(stored_pts)
    size_px, rotation_deg = _decode_ends(path, keyframe_pts)
    time_s = (pts - pts[0]) * float(time_base)
    num_repeated = len(stored_pts) - len(pts)
    return VideoInfo(
        path, codec, size_px, rotation_deg, pts, keyframe_pts, time_s, measured_rate_hz(time_s), num_repeated
    )


def _read_packets(
    container: InputContainer, stream: VideoStream
) -> tuple[Int[np.ndarray, " frames"], Int[np.ndarray, " keyframes"]]:
    """Timestamps of all frames that will be shown, as they are stored, and of the keyframes, without decoding."""
    pts: list[int] = []
    keyframes: list[int] = []
    is_corrupt = False
    for packet in container.demux(stream):
        if packet.size == 0 or packet.is_discard or _is_hidden(stream.codec_context.name, bytes(packet)):
            continue
        stamp = packet.dts if packet.pts is None else packet.pts
        is_corrupt = packet.is_corrupt
        if stamp is None:
            raise _UnusableError("video_times", f"Frame {len(pts)} has no time.", _REPAIR_TIMES)
        pts.append(stamp)
        if packet.is_keyframe:
            keyframes.append(stamp)
        if len(pts) > MAX_FRAMES:
            raise _UnusableError("video_too_long", f"The video has more than {MAX_FRAMES} frames.", "Cut it.")
    if is_corrupt:  # one before the last is a damaged frame, which its decoder marks
        raise _UnusableError("video_truncated", f"The file breaks off after {len(pts) - 1} frames.", "Copy it again.")
    return np.array(pts, np.int64), np.unique(np.array(keyframes, np.int64))


def _is_hidden(codec: str, content: bytes) -> bool:
    """Whether a packet is a VP8 frame that is not to be shown: the bit ``show_frame`` (RFC 6386, section 9.1)."""
    return codec == "vp8" and not content[0] & 0x10


def _shown_pts(stored_pts: Int[np.ndarray, " frames"]) -> Int[np.ndarray, " shown"]:
    """Timestamps in the order in which frames are shown, each once; an error if they can't all be right."""
    shown_pts = np.unique(stored_pts)
    if int(shown_pts[-1]) - int(shown_pts[0]) > _MAX_TICKS:
        raise _UnusableError("video_times", "The times of the frames make no sense.", _REPAIR_TIMES)
    num_repeated = len(stored_pts) - len(shown_pts)
    if num_repeated > _MAX_REPEATED_SHARE * len(stored_pts):
        raise _UnusableError(
            "video_times", f"{num_repeated} of {len(stored_pts)} frames repeat the time of another.", _REPAIR_TIMES
        )
    order = np.argsort(stored_pts, kind="stable")
    misplaced = np.flatnonzero(np.abs(order - np.arange(len(order))) > _MAX_REORDERED)
    if len(misplaced):
        message = f"The times of the frames go back, near frame {misplaced[0]}."
        raise _UnusableError("video_times", message, _REPAIR_TIMES)
    return shown_pts


def _decode_ends(path: Path, keyframe_pts: np.ndarray) -> tuple[tuple[int, int], int]:
    """Decode the first pictures, and one near the end, for size and rotation and to see that they can be had."""
    frames = list(islice(decode_from(path, [], int(keyframe_pts[0])), _NUM_DECODED))
    if not frames:
        raise _UnusableError("no_frames", "No frame of the video can be decoded.", "Record or export it again.")
    times = [pts for frame in frames if (pts := shown_at(frame)) is not None]
    if times != sorted(times):
        raise _UnusableError("video_times", "The times of the first frames go back.", _REPAIR_TIMES)
    if len(keyframe_pts) > 1:
        last_pts = int(keyframe_pts[-1])
        later = decode_from(path, seek_points(keyframe_pts, last_pts), last_pts)
        last = next((frame for frame in later if (shown_at(frame) or 0) >= last_pts), None)
        if last is None:
            raise _UnusableError("video_truncated", "The end of the video can't be decoded.", "Copy it again.")
        frames.append(last)
    first = frames[0]
    for frame in frames:
        if (frame.width, frame.height) != (first.width, first.height):
            raise _UnusableError(
                "video_changes_size",
                f"The pictures change their size from {first.width} x {first.height} to "
                f"{frame.width} x {frame.height} pixels.",
                "Cut the video there.",
            )
    rotation_deg = round(first.rotation / 90) * 90 % 360
    size_px = (first.width, first.height) if rotation_deg % 180 == 0 else (first.height, first.width)
    return size_px, rotation_deg


def problem_at_once(path: Path) -> Problem | None:
    """Problem of a file that is found without opening its container; ``None`` if there is none."""
    try:
        _check_start(path)
    except _UnusableError as error:
        return error.problem(path)
    except OSError:
        return _unreadable().problem(path)
    return None


def reading_s(path: Path) -> int:
    """Computing time (s) that a file may take beyond that of a small one."""
    return math.ceil(path.stat().st_size * _CPU_S_PER_BYTE)


def beyond_limits(name: str) -> Problem:
    """Problem of a file whose examination took more time or memory than it may."""
    return Problem(
        "video_unreadable",
        "The video could not be examined within the limits on time and memory.",
        file=name,
        hint="Convert it to H.264 in MP4.",
    )


def main() -> None:
    """Print what is known of the file as one JSON object, after a line that says that the program could be loaded."""
    path = Path(sys.argv[1])
    start_child(_MAX_CPU_S + reading_s(path))
    try:
        found = probe(path)
    except MemoryError:
        found = beyond_limits(path.name)
    if isinstance(found, Problem):
        answer: dict[str, Any] = {"problem": asdict(found)}
    else:
        answer = asdict(found) | {name: getattr(found, name).tolist() for name in ("pts", "keyframe_pts", "time_s")}
        del answer["path"]
    sys.stdout.write(json.dumps(answer) + "\n")


if __name__ == "__main__":
    main()
