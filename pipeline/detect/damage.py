"""Damaged frames of a session's videos: how many a reconstruction bears, and what a person should know of them."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Int

from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.session import CaptureSession
from pipeline.data import DamagedVideo
from pipeline.errors import InputError, Problem
from pipeline.video.timeline import frames_in, session_timebase, span_s

MAX_DAMAGED_SHARE = 0.1
"""Limit on the damaged share of a camera's frames, among the frames that a reconstruction uses."""


DamagedFrames = tuple[str, Int[np.ndarray, " _"]]
"""Name of a camera, and numbers of its frames whose picture is damaged or missing, ascending."""


def damaged_videos(
    session: CaptureSession | KeypointSession, damaged: Iterable[DamagedFrames]
) -> tuple[DamagedVideo, ...]:
    """Summarise the damage of each video that has damaged frames, in the cameras' order; there are none in keypoints.

    Parameters
    ----------
    session
        The session, restricted to the output frames that are wanted.
    damaged
        Damaged frames, range by range of a camera in the order of time.

    Raises
    ------
    InputError
        If the share of damaged frames is above ``MAX_DAMAGED_SHARE`` in a video; lists all such videos.
    """
    if isinstance(session, KeypointSession):
        return ()
    whole = session_timebase(session.times)
    output_frames = session.frames or range(whole.num_frames)
    span = span_s(whole, output_frames.start, output_frames.stop)
    of_camera: dict[str, list[int]] = {camera.name: [] for camera in session.cameras}
    for camera, some in damaged:
        of_camera[camera] += some.tolist()
    found = tuple(
        DamagedVideo(
            camera=camera.name,
            file=video.path.name,
            num_damaged=len(numbers),
            num_frames=len(frames_in(session.times[camera.name], *span)),
            first_s=float(video.time_s[numbers[0]]),
            last_s=float(video.time_s[numbers[-1]]),
        )
        for camera, video in zip(session.cameras, session.videos, strict=True)
        if (numbers := of_camera[camera.name])
    )
    if problems := [_problem(one) for one in found if one.num_damaged > MAX_DAMAGED_SHARE * one.num_frames]:
        raise InputError(problems)
    return found


def _problem(video: DamagedVideo) -> Problem:
    return Problem(
        "video_damaged",
        f"{video.num_damaged} of {video.num_frames} frames are damaged or can't be decoded, from {video.first_s:.1f} "
        f"to {video.last_s:.1f} s of the video; at most {MAX_DAMAGED_SHARE:.0%} may be.",
        file=video.file,
        camera=video.camera,
        hint="Copy the file again, or cut the damaged part away.",
    )
