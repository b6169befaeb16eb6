"""Several files that are the parts of one recording, as one video."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from pipeline.core.errors import Problem
from pipeline.core.problems.session_codes import PARTS_DIFFER, PARTS_GAP
from pipeline.video.frame_rate import measured_rate_hz
from pipeline.video.images.files import SEQUENCE
from pipeline.video.info import VideoInfo

# Share by which measured rates of parts may differ.
_SAME_RATE = 0.002
# Clocks of files: timecode counts frames, times of creation have whole seconds and may be the end of a file.
_MAX_TIMECODE_GAP_S, _MAX_CREATION_GAP_S = 0.2, 2.5


def join_parts(parts: Sequence[VideoInfo]) -> VideoInfo:
    """Put videos together to one, each beginning a frame after the last of the one before.

    The frames of the whole are numbered through. Its times are those that the recording would have in one file, to the
    tick, if the parts have the same clock. Only ``decode`` and the like know of the parts.

    ``parts``: videos in order, at least one, without ``seam_problems``.
    """
    if len(parts) == 1:
        return parts[0]
    first = parts[0]
    rate_hz = max(parts, key=lambda part: part.num_frames).frame_rate_hz
    pts, keyframe_pts, time_s = [], [], []
    start_pts, start_s = 0, 0.0
    for part in parts:
        pts.append(part.pts - part.pts[0] + start_pts)
        keyframe_pts.append(part.keyframe_pts - part.pts[0] + start_pts)
        time_s.append(part.time_s + start_s)
        start_pts = int(pts[-1][-1]) + max(1, round(1 / (rate_hz * part.tick_s)))
        start_s = float(time_s[-1][-1]) + 1 / rate_hz
    joined_pts = np.concatenate(pts)
    has_one_clock = len({part.tick_s for part in parts}) == 1
    joined_s = joined_pts * first.tick_s if has_one_clock else np.concatenate(time_s)
    return replace(
        first,
        pts=joined_pts,
        keyframe_pts=np.concatenate(keyframe_pts),
        time_s=joined_s,
        frame_rate_hz=measured_rate_hz(joined_s),
        num_repeated=sum(part.num_repeated for part in parts),
        warnings=tuple(warning for part in parts for warning in part.warnings),
        browser_media_type=None,
        media_start_s=0.0,
        parts=tuple(parts),
    )


def seam_problems(parts: Sequence[VideoInfo]) -> Iterator[Problem]:
    """Report parts that can't be of one recording: other pictures than in the first part, or a gap before."""
    for before, part in pairwise(parts):
        if differences := _differences(parts[0], part):
            message = f"This file can't be a part of the recording of {parts[0].path.name}: {'; '.join(differences)}."
            hint = "Give each camera the files of one recording, as the camera wrote them."
            yield Problem(PARTS_DIFFER, message, file=part.path.name, hint=hint)
        elif (gap_s := _gap_s(before, part)) is not None:
            message = f"By the clocks of the files {gap_s:.1f} s are missing between {before.path.name} and this file."
            hint = "Add the part in between, or send one part alone: a recording has no gap."
            yield Problem(PARTS_GAP, message, file=part.path.name, hint=hint)


def _differences(first: VideoInfo, part: VideoInfo) -> list[str]:
    (width, height), (other_width, other_height) = first.stored_size_px, part.stored_size_px
    differences = []
    if SEQUENCE in {first.codec, part.codec}:
        differences.append("images have no parts")
    elif first.codec != part.codec:
        differences.append(f"the codec is {part.codec}, not {first.codec}")
    if (width, height, first.size_px) != (other_width, other_height, part.size_px):
        differences.append(f"it has {other_width} x {other_height} pixels, not {width} x {height}")
    if first.rotation_deg != part.rotation_deg:
        differences.append(f"its picture is turned by {part.rotation_deg} degrees, not {first.rotation_deg}")
    if first.is_mirrored != part.is_mirrored:
        differences.append(f"its picture is {'' if part.is_mirrored else 'not '}mirrored")
    is_long = min(first.num_frames, part.num_frames) > 1
    if is_long and abs(part.frame_rate_hz / first.frame_rate_hz - 1) > _SAME_RATE:
        differences.append(f"it has {part.frame_rate_hz:.6g} frames a second, not {first.frame_rate_hz:.6g}")
    return differences


def _gap_s(before: VideoInfo, part: VideoInfo) -> float | None:
    """Time that is missing between two parts by the clocks of their files; ``None`` without a gap, or without clocks.

    Some cameras give all parts the time of the whole recording, and some a time of creation at the end of the file:
    neither is a gap.
    """
    length_s = before.num_frames / before.frame_rate_hz
    if before.timecode is not None and part.timecode is not None:
        day_s = before.timecode.day_s
        gap_s = (part.timecode.time_s - before.timecode.time_s) % day_s - length_s
        return gap_s if _MAX_TIMECODE_GAP_S < gap_s < day_s / 2 else None
    if before.created_s is not None and part.created_s is not None:
        longest_s = max(length_s, part.num_frames / part.frame_rate_hz)
        gap_s = part.created_s - before.created_s - longest_s
        return gap_s if gap_s > _MAX_CREATION_GAP_S else None
    return None
