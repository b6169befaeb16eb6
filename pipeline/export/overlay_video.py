"""Overlay videos: each camera's video with the skeletons drawn over it."""

from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from pipeline.calibration.sizes import scaled
from pipeline.capture.session import Session
from pipeline.core.data.heads import HeadRegions
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.export.overlay import draw_skeletons, given_names, people_at
from pipeline.export.privacy.blur import blur_ellipses
from pipeline.video.decode import decode
from pipeline.video.playback.h264 import even_size_px
from pipeline.video.playback.written import write_pictures
from pipeline.video.timeline import frames_in

LONG_SIDE_PX = 1280
"""Longest side of an overlay's pictures; smaller videos keep their size."""

_MAX_NAME = 60


def overlay_names(cameras: Sequence[str]) -> tuple[str, ...]:
    """Names of the overlay videos of cameras: letters and digits of ASCII, all different.

    >>> overlay_names(["Cam 1", "cam/1", "left"])
    ('overlay-Cam-1.mp4', 'overlay-cam-1-2.mp4', 'overlay-left.mp4')
    """
    names: list[str] = []
    taken: set[str] = set()
    for camera in cameras:
        kept = "".join(
            letter if letter.isascii() and (letter.isalnum() or letter in "_-") else " " for letter in camera
        )
        word = "-".join(kept.split())[:_MAX_NAME] or "camera"
        name, number = word, 1
        while name.lower() in taken:
            number += 1
            name = f"{word}-{number}"
        taken.add(name.lower())
        names.append(f"overlay-{name}.mp4")
    return tuple(names)


def draw_video(
    session: Session,
    take: Reconstruction,
    camera: str,
    path: Path,
    on_frame: Callable[[], object],
    heads: HeadRegions | None = None,
) -> bool:
    """Write the overlay video of a camera, frame by frame: the memory does not grow with its length.

    The skeletons are at the time of each frame: between output frames, and on the session's clock.

    Parameters
    ----------
    session
        Session of the take, on measured clocks if they were measured.
    on_frame
        Called after each frame; an exception from it ends the work.
    heads
        Heads that are blurred below the skeletons; ``None``: none are.

    Returns
    -------
        Whether the camera took frames of the take; otherwise there is no video.

    Raises
    ------
    InputError
        See ``pipeline.video.decode.decode``.
    """
    video, times = session.video_of[camera], session.times[camera]
    timebase = take.timebase
    frames = frames_in(times, timebase.time_s(-0.5), timebase.time_s(timebase.num_frames - 0.5))
    if not frames:
        return False
    (shown,) = (known for known in take.cameras if known.name == camera)
    size_px = even_size_px(shown.size_px, LONG_SIDE_PX)
    small, time_s = scaled(shown, size_px), times.time_s[frames.start : frames.stop]

    names = given_names(take.motions)

    def drawn() -> Generator[tuple[int, UInt8[np.ndarray, "height width 3"]], None, None]:
        with closing(decode(video, frames.start, frames.stop)) as decoded:
            for frame, image_rgb in decoded:
                picture = cv2.resize(np.ascontiguousarray(image_rgb), size_px, interpolation=cv2.INTER_AREA)
                if heads is not None:
                    picture = blur_ellipses(picture, heads.in_frame(frame, size_px))
                people_m = people_at(take.tracks, timebase, float(times.time_s[frame]))
                yield frame - frames.start, draw_skeletons(picture, small, people_m, take.joints, names)
                on_frame()

    with closing(drawn()) as pictures:
        return write_pictures(path, pictures, time_s, size_px) > 0
