"""Damaged frames of a session's videos: a summary for users, and the limit of a reconstruction."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Int

from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.session import CaptureSession
from pipeline.data import DamagedVideo, PictureChanges
from pipeline.detect.doubled import doubled_frames, join_changes
from pipeline.errors import InputError, Problem
from pipeline.video.timeline import frames_in, session_timebase, span_s

MAX_DAMAGED_SHARE = 0.1
"""Limit on the damaged share of a camera's frames, among the frames that a reconstruction uses."""


DamagedFrames = tuple[str, Int[np.ndarray, " _"]]
"""Name of a camera, and ascending numbers of its frames with a damaged or missing picture."""


def damaged_videos(
    session: CaptureSession | KeypointSession,
    damaged: Iterable[DamagedFrames],
    changes: Iterable[tuple[str, PictureChanges]] = (),
) -> tuple[DamagedVideo, ...]:
    """Summarise the damaged and doubled frames of each video, in the cameras' order; a keypoint session has none.

    Parameters
    ----------
    session
        Session, restricted to the output frames of the reconstruction.
    damaged
        Damaged frames of ranges; the ranges of a camera are in order of time.
    changes
        Cameras and changes of the pictures of the same ranges.

    Raises
    ------
    InputError
        If the share of damaged frames exceeds ``MAX_DAMAGED_SHARE`` in a video; lists all such videos.
    """
    if isinstance(session, KeypointSession):
        return ()
    whole = session_timebase(session.times)
    output_frames = session.frames or range(whole.num_frames)
    span = span_s(whole, output_frames.start, output_frames.stop)
    of_camera: dict[str, list[int]] = {camera.name: [] for camera in session.cameras}
    for camera, frames in damaged:
        of_camera[camera] += frames.tolist()
    parts: dict[str, list[PictureChanges]] = {camera.name: [] for camera in session.cameras}
    for camera, part in changes:
        parts[camera].append(part)
    doubled = {camera: doubled_frames(join_changes(of_ranges)) for camera, of_ranges in parts.items()}
    videos = tuple(
        DamagedVideo(
            camera=camera.name,
            file=video.path.name,
            num_damaged=len(numbers),
            num_frames=len(frames_in(session.times[camera.name], *span)),
            first_s=float(video.time_s[numbers[0]]) if numbers else 0.0,
            last_s=float(video.time_s[numbers[-1]]) if numbers else 0.0,
            doubled_s=tuple(video.time_s[doubled[camera.name]].tolist()),
        )
        for camera, video in zip(session.cameras, session.videos, strict=True)
        if (numbers := of_camera[camera.name]) or len(doubled[camera.name])
    )
    if problems := [_problem(video) for video in videos if video.num_damaged > MAX_DAMAGED_SHARE * video.num_frames]:
        raise InputError(problems)
    return videos


def _problem(video: DamagedVideo) -> Problem:
    return Problem(
        "video_damaged",
        f"{video.num_damaged} of {video.num_frames} frames are damaged or can't be decoded, from {video.first_s:.1f} "
        f"to {video.last_s:.1f} s of the video; at most {MAX_DAMAGED_SHARE:.0%} may be.",
        file=video.file,
        camera=video.camera,
        hint="Copy the file again, or cut the damaged part away.",
    )
