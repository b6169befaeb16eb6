"""Damaged frames of a session's videos: a summary for users, and the limit of a reconstruction."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Int

from pipeline.capture.session import CaptureSession
from pipeline.core.data.detections import DamagedVideo, PictureChanges
from pipeline.core.errors import InputError, Problem
from pipeline.core.problems.sessions import VIDEO_DAMAGED
from pipeline.detection.doubled import doubled_frames, join_changes
from pipeline.video.timeline import frames_in, session_timebase, span_s

MAX_DAMAGED_SHARE = 0.1
"""Limit on the damaged share of a camera's frames, among the frames that a reconstruction uses."""


CheckedPictures = tuple[str, Int[np.ndarray, " _"], PictureChanges]
"""Name of a camera, ascending numbers of its frames with a damaged or missing picture, and changes of its pictures."""


def damaged_videos(session: CaptureSession, pictures: Iterable[CheckedPictures]) -> tuple[DamagedVideo, ...]:
    """Summarise the damaged and doubled frames of each video, in the cameras' order.

    Parameters
    ----------
    session
        Session, restricted to the output frames of the reconstruction.
    pictures
        Pictures of ranges; the ranges of a camera are in order of time.

    Raises
    ------
    InputError
        If the share of damaged frames exceeds ``MAX_DAMAGED_SHARE`` in a video; lists all such videos.
    """
    whole = session_timebase(session.times)
    output_frames = session.frames or range(whole.num_frames)
    span = span_s(whole, output_frames.start, output_frames.stop)
    damaged: dict[str, list[int]] = {camera: [] for camera in session.video_of}
    changes: dict[str, list[PictureChanges]] = {camera: [] for camera in session.video_of}
    for camera, frames, of_range in pictures:
        damaged[camera] += frames.tolist()
        changes[camera].append(of_range)
    doubled = {camera: doubled_frames(join_changes(of_ranges)) for camera, of_ranges in changes.items()}
    videos = tuple(
        DamagedVideo(
            camera=camera,
            file=video.path.name,
            num_damaged=len(numbers),
            num_frames=len(frames_in(session.times[camera], *span)),
            first_s=float(video.time_s[numbers[0]]) if numbers else 0.0,
            last_s=float(video.time_s[numbers[-1]]) if numbers else 0.0,
            doubled_s=tuple(video.time_s[doubled[camera]].tolist()),
        )
        for camera, video in session.video_of.items()
        if (numbers := damaged[camera]) or len(doubled[camera])
    )
    if problems := [_problem(video) for video in videos if video.num_damaged > MAX_DAMAGED_SHARE * video.num_frames]:
        raise InputError(problems)
    return videos


def _problem(video: DamagedVideo) -> Problem:
    return Problem(
        VIDEO_DAMAGED,
        f"{video.num_damaged} of {video.num_frames} frames are damaged or can't be decoded, from {video.first_s:.1f} "
        f"to {video.last_s:.1f} s of the video; at most {MAX_DAMAGED_SHARE:.0%} may be.",
        file=video.file,
        camera=video.camera,
        hint="Copy the file again, or cut the damaged part away.",
    )
