"""Starts of a session's videos by the clock that the client chose: stated offsets, timecode, or times of creation."""

from collections.abc import Mapping, Sequence

from pipeline.capture.preflight_record import Clock
from pipeline.core.errors import Problem
from pipeline.core.findings import Finding
from pipeline.core.problems.finding_codes import COARSE_CLOCK
from pipeline.core.problems.session_codes import NO_CREATION_TIME, NO_TIMECODE
from pipeline.video.info import Timecode, VideoInfo

_DECLARED = "Omit the clock and state the offsets of the videos."
# A clock whose frames are this much longer than the video's leaves the start within a frame unknown.
_MIN_COARSE = 1.5


def starts_s(videos: Mapping[str, VideoInfo], clock: Clock) -> tuple[Mapping[str, float], list[Problem]]:
    """Times of the videos' first frames on a clock that starts with the earliest video.

    ``videos``: videos by camera name, at least one. ``clock``: with ``declared`` all videos start together.

    The result has:

    - ``starts_s``: times by camera name; of a session across midnight, timecodes before it count for the day before.
    - ``problems``: videos without such a clock.
    """
    if clock == "declared":
        return dict.fromkeys(videos, 0.0), []
    stated_s = {camera: _stated_s(video, clock) for camera, video in videos.items()}
    known_s = {camera: time_s for camera, time_s in stated_s.items() if time_s is not None}
    if len(known_s) < len(stated_s):
        return dict.fromkeys(videos, 0.0), [
            _without(camera, videos[camera], clock) for camera, time_s in stated_s.items() if time_s is None
        ]
    if clock == "timecode":
        known_s = _across_midnight([(camera, video.timecode) for camera, video in videos.items() if video.timecode])
    begin_s = min(known_s.values())
    return {camera: time_s - begin_s for camera, time_s in known_s.items()}, []


def clock_findings(videos: Mapping[str, VideoInfo], clock: Clock) -> list[Finding]:
    """Tell of clocks that are coarser than a frame."""
    if clock == "creation_time":
        message = (
            "The videos are placed by their times of creation, which most cameras state in whole seconds: the cameras "
            "may be off from each other by a second."
        )
        return [Finding(COARSE_CLOCK, message, hint="Use timecode, state offsets, or synchronise by the people.")]
    if clock == "declared":
        return []
    return [
        Finding(
            COARSE_CLOCK,
            f"The timecode counts {video.timecode.rate_hz:.6g} frames a second, the video has "
            f"{video.frame_rate_hz:.6g}: its start is known to {1000 / video.timecode.rate_hz:.0f} ms.",
            camera,
            evidence={
                "file": video.path.name,
                "timecode_rate_hz": video.timecode.rate_hz,
                "frame_rate_hz": video.frame_rate_hz,
            },
            hint="State an offset of this camera beside the timecode if its people lag behind.",
        )
        for camera, video in videos.items()
        if video.timecode is not None and video.frame_rate_hz > _MIN_COARSE * video.timecode.rate_hz
    ]


def start_hint(clock: Clock) -> str:
    """Remedy of videos that do not overlap."""
    if clock == "declared":
        return "Check the offsets: seconds at which the first frames were taken."
    kind = "timecodes" if clock == "timecode" else "times of creation"
    return f"Check the cameras' clocks: the {kind} of the videos lie too far apart. {_DECLARED}"


def _stated_s(video: VideoInfo, clock: Clock) -> float | None:
    if clock == "creation_time":
        return video.created_s
    return None if video.timecode is None else video.timecode.time_s


def _across_midnight(timecodes: Sequence[tuple[str, Timecode]]) -> dict[str, float]:
    """Times by camera: negative before midnight if other cameras started early in the day after it."""
    shares = sorted(timecode.time_s / timecode.day_s for _, timecode in timecodes)
    # The largest pause between two starts, also from the last to the first, is where the session did not record.
    pauses = [after - before for before, after in zip(shares, [*shares[1:], shares[0] + 1.0], strict=True)]
    last = pauses.index(max(pauses))
    is_across = last < len(shares) - 1
    return {
        camera: timecode.time_s - timecode.day_s * (is_across and timecode.time_s / timecode.day_s > shares[last])
        for camera, timecode in timecodes
    }


def _without(camera: str, video: VideoInfo, clock: Clock) -> Problem:
    if clock == "timecode":
        return Problem(
            NO_TIMECODE, "The video has no timecode.", file=video.path.name, camera=camera, field="clock",
            hint=_DECLARED,
        )  # fmt: skip
    return Problem(
        NO_CREATION_TIME, "The video states no time of creation.", file=video.path.name, camera=camera, field="clock",
        hint=_DECLARED,
    )  # fmt: skip
