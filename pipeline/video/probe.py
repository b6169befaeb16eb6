"""Examine video files, each in its own process: ``python -m pipeline.video.probe``.

All packets of a file are read, but only its first pictures and one near the end are decoded. The stages decode the
other frames later, once.

The program loads the libraries once, and forks a process with limits for each file. It never opens a file itself.
Stdin has a JSON list of the files' paths, each with its time limit.
For each file a JSON line is written with its number and the end of its process, followed by what that wrote: the line
``READY``, then the properties or the problem of the file as JSON. After a failure that no file causes the rest is left.
"""

import json
import sys
from dataclasses import asdict, replace
from fractions import Fraction
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from av.container import InputContainer
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from pipeline.core.errors import Problem, UnusableError
from pipeline.core.problems import session_codes
from pipeline.core.problems.finding_codes import FIRST_PICTURE_MOVED, INTERLACED_VIDEO, PIXEL_ASPECT
from pipeline.core.runtime import confinement
from pipeline.video import container as containers
from pipeline.video.frame_rate import measured_rate, measured_rate_hz, uneven_times
from pipeline.video.images.files import is_sequence
from pipeline.video.images.image_probe import probe_images
from pipeline.video.info import VideoInfo, seek_points
from pipeline.video.orientation import display_orientation, mirrored
from pipeline.video.properties.container_clocks import created_s, read_timecode
from pipeline.video.properties.packets import REPAIR_TIMES, list_packets, shown_pts, unknown_delays
from pipeline.video.signatures import document_type, is_container, is_cut_avi
from pipeline.video.stamps import starts_at_zero

_NUM_DECODED = 8
_AVI_ORDER = "AVI can't state the times of H.264 with B-frames: export the video again as MP4 or MKV."
_AT_ONCE = 2

# Limit on the computing time for a small file.
_MAX_CPU_S = 8
# Encoders that round sizes write ratios such as 404:405. Real ones, from 8:9 on, differ from 1 by a tenth.
_MAX_ROUNDING = 0.01
# Widest and narrowest pixels of real formats are 2:1 (anamorphic film) and 8:9; others are errors of a file.
_MAX_ASPECT = 4


def probe(path: Path) -> VideoInfo | Problem:
    """Examine one file in this process. Returns properties of the video, or the problem that makes it unusable."""
    try:
        return _probe(path)
    except UnusableError as error:
        return error.problem(path)
    except containers.DECODE_ERRORS:
        return _unreadable().problem(path)


def _unreadable() -> UnusableError:
    return UnusableError(
        session_codes.VIDEO_UNREADABLE,
        "The file is not a readable video, or it is damaged.",
        "An interrupted recording has no index. Record or export the video again.",
    )


def _check_start(path: Path) -> None:
    """Raise ``UnusableError`` for a missing or empty file, or one that is not a video container.

    FFmpeg does not open the file.
    """
    if not path.exists():
        raise UnusableError(session_codes.VIDEO_MISSING, "The video file does not exist.")
    if path.is_dir():
        return
    if path.stat().st_size == 0:
        raise UnusableError(session_codes.VIDEO_EMPTY, "The file is empty.", "Copy it again.")
    if not is_container(path) and not is_sequence(path):
        raise _unreadable()


def _probe(path: Path) -> VideoInfo:
    _check_start(path)
    if is_sequence(path):
        return probe_images(path)
    with containers.open_container(path) as container:
        stream = containers.first_video(container)
        if stream is None:
            raise UnusableError(
                session_codes.NO_VIDEO_STREAM,
                "The file has no video stream that can be decoded.",
                "Check that the file is not audio only.",
            )
        codec = stream.codec_context.codec.canonical_name
        if codec not in containers.CODECS:
            raise UnusableError(
                session_codes.UNSUPPORTED_CODEC,
                f"The codec {codec} is not supported.",
                f"Convert the video to one of {', '.join(sorted(containers.CODECS))}.",
            )
        if stream.codec_context.width * stream.codec_context.height > containers.MAX_PIXELS:
            raise _too_large()
        announced, time_base, pixel_aspect = (
            _announced(path, container, stream),
            stream.time_base,
            stream.sample_aspect_ratio,
        )
        video_format = VideoFormat(
            container=container.format.name,
            brand=container.metadata.get("major_brand", "") or document_type(path),
            codec=codec,
            profile=stream.codec_context.profile,
            pixel_format=stream.codec_context.pix_fmt,
            size_px=(stream.codec_context.width, stream.codec_context.height),
        )
        metadata = _metadata(container)
        first_pts = stream.start_time if starts_at_zero(container) else None
        packets = list_packets(container, stream)
    stored_pts, keyframe_pts, num_read = packets.pts, packets.keyframe_pts, packets.num_read
    if time_base is None or not len(stored_pts):
        raise UnusableError(session_codes.NO_FRAMES, "The video has no frames.", "Record or export it again.")
    if not len(keyframe_pts):
        raise UnusableError(
            session_codes.NO_KEYFRAMES,
            "The video has no frame at which decoding can start.",
            "Record or export it again.",
        )
    if announced > num_read + 1:
        raise UnusableError(
            session_codes.VIDEO_TRUNCATED,
            f"The file is truncated after {num_read} frames.",
            "Copy it again.",
        )
    pts = shown_pts(stored_pts)
    frames = _decode_ends(path, keyframe_pts, _AVI_ORDER if video_format.container == "avi" else REPAIR_TIMES)
    width, height = frames[0].width, frames[0].height
    square_width, warnings = square_pixels(width, pixel_aspect)
    if square_width * height > containers.MAX_PIXELS:
        raise _too_large()
    if any(frame.interlaced_frame for frame in frames):
        warnings.append(interlaced())
    rotation_deg, is_mirrored = display_orientation(frames[0])
    if is_mirrored:
        warnings.append(mirrored())
    time_s = (pts - pts[0]) * float(time_base)
    if first_pts is not None and pts[0] > first_pts:
        warnings.append(_moved((int(pts[0]) - first_pts) * float(time_base)))
    warnings += [*uneven_times(time_s), *unknown_delays(path)]
    return VideoInfo(
        path=path,
        codec=codec,
        size_px=(square_width, height) if rotation_deg % 180 == 0 else (height, square_width),
        rotation_deg=rotation_deg,
        is_mirrored=is_mirrored,
        pts=pts,
        keyframe_pts=keyframe_pts,
        time_s=time_s,
        frame_rate_hz=measured_rate_hz(time_s),
        num_repeated=len(stored_pts) - len(pts),
        stored_width_px=width if width != square_width else None,
        timecode=read_timecode(path, metadata, measured_rate(time_s)),
        created_s=created_s(metadata),
        warnings=tuple(replace(warning, file=path.name) for warning in warnings),
        # Firefox ignores the mirroring.
        browser_media_type=None if is_mirrored else browser_media_type(video_format),
        media_start_s=float(pts[0] * time_base),
        tick_s=float(time_base),
    )


def _too_large() -> UnusableError:
    return UnusableError(
        session_codes.VIDEO_TOO_LARGE, f"The picture has more than {containers.MAX_PIXELS} pixels.", "Scale it down."
    )


def _moved(early_s: float) -> Problem:
    return Problem(
        FIRST_PICTURE_MOVED,
        f"The file states the first picture {1000 * early_s:.0f} ms early: it is taken a frame before the second one.",
        hint="Programs write such times in fragmented MP4 files whose sound starts before the pictures.",
    )


def _metadata(container: InputContainer) -> dict[str, str]:
    """Entries of the streams and of the container; the container's have precedence."""
    found: dict[str, str] = {}
    for stream in container.streams:
        found |= stream.metadata
    return found | container.metadata


def _announced(path: Path, container: InputContainer, stream: VideoStream) -> int:
    """Number of packets that the header announces; 0 if it does not.

    The index of MP4 and MOV has an entry for each packet that the file's edit list leaves, before anything is read. The
    header of AVI counts the places of dropped frames too: its number means something only if the file is cut off.
    """
    if "mp4" in container.format.name.split(","):
        return min(stream.frames, len(stream.index_entries))
    if container.format.name == "avi" and not is_cut_avi(path):
        return 0
    return stream.frames


def _decode_ends(path: Path, keyframe_pts: np.ndarray, repair_times: str) -> list[VideoFrame]:
    """Decode the first pictures and one near the end, all of one size; raise if decoding fails."""
    frames = list(islice(containers.decode_from(path, [], int(keyframe_pts[0])), _NUM_DECODED))
    if not frames:
        raise UnusableError(
            session_codes.NO_FRAMES, "No frame of the video can be decoded.", "Record or export it again."
        )
    times = [pts for frame in frames if (pts := containers.display_pts(frame)) is not None]
    if times != sorted(times):
        raise UnusableError(session_codes.VIDEO_TIMES, "The timestamps of the first frames go backwards.", repair_times)
    if len(keyframe_pts) > 1:
        last_pts = int(keyframe_pts[-1])
        later = containers.decode_from(path, seek_points(keyframe_pts, last_pts), last_pts)
        last = next((frame for frame in later if (containers.display_pts(frame) or 0) >= last_pts), None)
        if last is None:
            raise UnusableError(
                session_codes.VIDEO_TRUNCATED, "The end of the video can't be decoded.", "Copy it again."
            )
        frames.append(last)
    first = frames[0]
    for frame in frames:
        if (frame.width, frame.height) != (first.width, first.height):
            raise UnusableError(
                session_codes.VIDEO_CHANGES_SIZE,
                f"The pictures change their size from {first.width} x {first.height} to "
                f"{frame.width} x {frame.height} pixels.",
                "Cut the video there.",
            )
    return frames


def problem_before_opening(path: Path) -> Problem | None:
    """Return the problem of a missing or empty file, or of one that is not a video container; else ``None``."""
    try:
        _check_start(path)
    except UnusableError as error:
        return error.problem(path)
    except OSError:
        return _unreadable().problem(path)
    return None


def limits_problem(name: str) -> Problem:
    """Build the problem of a file that exceeded the limits on time or memory."""
    return Problem(
        session_codes.VIDEO_UNREADABLE,
        "The video could not be examined within the limits on time and memory.",
        file=name,
        hint="Convert the video to H.264 in MP4.",
    )


def is_of_file(fork: confinement.Fork) -> bool:
    """Return whether a process ended well, or by a fault of its file, and by no other failure."""
    return fork.output.startswith(confinement.READY) and (
        not fork.exit_code or confinement.is_caused_by_file(fork.exit_code)
    )


def main() -> None:
    """Examine the files."""
    confinement.confined_arguments()
    confinement.tell_ready()
    tasks = [(partial(_answer, Path(path)), timeout_s) for path, timeout_s in json.load(sys.stdin)]
    for fork in confinement.run_in_forks(tasks, _AT_ONCE):
        end = {"number": fork.number, "exit_code": fork.exit_code, "errors": fork.errors, "size": len(fork.output)}
        sys.stdout.buffer.write(json.dumps(end).encode() + b"\n" + fork.output)
        sys.stdout.flush()
        if not is_of_file(fork):
            return


def _answer(path: Path) -> None:
    """Print the line ``READY``, then the properties or the problem of the file as one JSON object."""
    confinement.confine(confinement.ChildLimits(_MAX_CPU_S + containers.reading_s(path)))
    confinement.tell_ready()
    try:
        result = probe(path)
    except MemoryError:
        result = limits_problem(path.name)
    if isinstance(result, Problem):
        answer: dict[str, Any] = {"problem": asdict(result)}
    else:
        answer = asdict(result) | {name: getattr(result, name).tolist() for name in ("pts", "keyframe_pts", "time_s")}
        del answer["path"]
    sys.stdout.write(json.dumps(answer) + "\n")


def square_pixels(width_px: int, pixel_aspect: Fraction | None) -> tuple[int, list[Problem]]:
    """Width of a picture whose pixels are made square, and a warning if they are not.

    ``pixel_aspect`` is the width of a stored pixel over its height, as the file states it (sample aspect ratio);
    ``None`` or 0 is unknown, and counts as square.
    """
    if not pixel_aspect or abs(pixel_aspect - 1) <= _MAX_ROUNDING:
        return width_px, []
    shape = f"{pixel_aspect.numerator}:{pixel_aspect.denominator}"
    if not Fraction(1, _MAX_ASPECT) <= pixel_aspect <= _MAX_ASPECT:
        message = f"The file states pixels of {shape}, which is not plausible. They are taken as square."
        return width_px, [Problem(PIXEL_ASPECT, message, hint="Export the video with square pixels.")]
    square_px = max(1, round(width_px * pixel_aspect))
    message = f"The pixels are not square ({shape}): the pictures are scaled from {width_px} to {square_px} columns."
    return square_px, [
        Problem(PIXEL_ASPECT, message, hint="The calibration may be of the stored or of the scaled pictures.")
    ]


def interlaced() -> Problem:
    """Build the warning of a video whose pictures are made of two fields."""
    return Problem(
        INTERLACED_VIDEO,
        "The video is interlaced: each picture shows two instants, and moving people have combed edges.",
        hint="Record progressively, or deinterlace the video before.",
    )


_MAX_LONG_SIDE_PX = 4096
_MAX_PIXELS = 4096 * 2304
"""Largest picture of H.264's level 5.2."""

_H264_PROFILES = frozenset({"Baseline", "Constrained Baseline", "Main", "High"})
_EIGHT_BITS = frozenset({"yuv420p", "yuvj420p"})


class VideoFormat(NamedTuple):
    """Format of a video file, in FFmpeg's names."""

    container: str  # Name of the demuxer, such as "mov,mp4,m4a,3gp,3g2,mj2"
    brand: str  # Major brand of an MP4 or QuickTime file, or document type of a Matroska file ("webm"); else empty
    # Of the video stream; the profile may be unknown
    codec: str
    profile: str | None
    pixel_format: str | None
    size_px: tuple[int, int]  # Width and height of the stored pictures


def browser_media_type(video: VideoFormat) -> str | None:
    """Media type by which Chromium, Firefox and Safari play a video; ``None`` if one of them may not.

    Chromium plays H.264 also in QuickTime and Matroska files, and AV1; other browsers don't on every machine.
    """
    width, height = video.size_px
    if max(width, height) > _MAX_LONG_SIDE_PX or width * height > _MAX_PIXELS:
        return None
    if video.pixel_format not in _EIGHT_BITS:
        return None
    if "mp4" in video.container.split(","):
        is_playable = video.codec == "h264" and video.profile in _H264_PROFILES and video.brand.strip() != "qt"
        return "video/mp4" if is_playable else None
    if video.brand == "webm":
        return "video/webm" if video.codec in {"vp8", "vp9"} else None
    return None


if __name__ == "__main__":
    main()
