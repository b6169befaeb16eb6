"""Small pictures of a camera: a few a second, and together no more bytes than allowed."""

from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.capture.session import Session
from pipeline.core.data.cameras import FrameTimes, Timebase
from pipeline.core.data.detections import Detections, HeadRegions
from pipeline.core.data.people import Observations, Track3D
from pipeline.core.progress import OnShare
from pipeline.export.privacy.blur import blur_ellipses
from pipeline.video.decode import decode
from pipeline.video.playback.h264 import even_size_px
from pipeline.video.timeline import frames_in

LONG_SIDE_PX = 640
"""Longest side of the pictures; smaller videos keep their size."""
MAX_RATE_HZ = 10.0
"""Largest number of pictures of a camera in a second."""

_JPEG_QUALITY = 75
# Usual size of a picture, by which a long take gets fewer pictures a second.
_USUAL_BYTES = 2**15


@dataclass(frozen=True, slots=True)
class SmallPicture:
    """Picture of a camera."""

    time_s: float  # Time at which it was taken, on the session's clock
    jpeg: bytes  # Compressed picture


def small_size_px(size_px: tuple[int, int]) -> tuple[int, int]:
    """Width and height of the small pictures of a camera."""
    return even_size_px(size_px, LONG_SIDE_PX)


def small_pictures(
    session: Session,
    timebase: Timebase,
    camera: str,
    max_bytes: int,
    on_share: OnShare,
    heads: HeadRegions | None = None,
) -> Iterator[SmallPicture]:
    """Decode the pictures of a camera in the frames of a take, in order, one at a time.

    A picture that would exceed its share of ``max_bytes`` is left out, so that all of them together never do. ``heads``
    are blurred; ``None``: none are.

    Raises ``InputError``: see ``pipeline.video.decode.decode``.
    """
    video, times = session.camera_videos[camera], session.times[camera]
    frames = frames_in(times, timebase.time_s(-0.5), timebase.time_s(timebase.num_frames - 0.5))
    time_s = times.time_s[frames.start : frames.stop]
    chosen = (frames.start + thinned(time_s, max(1, max_bytes // _USUAL_BYTES))).tolist()
    num_bytes = 0
    with closing(decode(video, frames.start, frames.stop, only=chosen)) as decoded:
        for number, (frame, image_rgb) in enumerate(decoded, 1):
            size_px = small_size_px((image_rgb.shape[1], image_rgb.shape[0]))
            picture = cv2.resize(np.ascontiguousarray(image_rgb), size_px, interpolation=cv2.INTER_AREA)
            if heads is not None:
                picture = blur_ellipses(picture, heads.in_frame(frame, size_px))
            bgr = cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
            _, encoded = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
            if num_bytes + encoded.size <= max_bytes * number / len(chosen):
                num_bytes += encoded.size
                yield SmallPicture(float(times.time_s[frame]), encoded.tobytes())
            on_share(number / len(chosen))
    on_share(1.0)


def thinned(time_s: Float[np.ndarray, " frames"], max_pictures: int) -> Int[np.ndarray, " chosen"]:
    """Choose frames at even times, at most ``MAX_RATE_HZ`` in a second and ``max_pictures`` in all.

    >>> thinned(np.arange(60) / 60.0, 1000)
    array([ 0,  6, 12, 18, 24, 30, 36, 42, 48, 54])
    >>> thinned(np.arange(60) / 60.0, 3)
    array([ 0, 30, 59])
    """
    if not len(time_s):
        return np.empty(0, int)
    since_s = time_s - time_s[0]
    rate_hz = min(MAX_RATE_HZ, (max_pictures - 1) / since_s[-1]) if since_s[-1] > 0.0 else MAX_RATE_HZ
    # Frames a little before the tick, by the rounding of their times, belong to it.
    ticks = np.floor(since_s * rate_hz + 0.01)
    return np.unique(ticks, return_index=True)[1]


# Distance of a body's joints from a person's observations, in diagonals of its box, within which the body is theirs.
# Observations are between two frames of the camera, which take a body a small part of its size further.
_NEAR = 0.1


def is_unmatched(
    detections: Detections,
    times: FrameTimes,
    camera: int,
    timebase: Timebase,
    people: Iterable[tuple[Track3D, Observations]],
) -> Bool[np.ndarray, " n"]:
    """Tell which bodies of a camera no person was given.

    A body is a person's if the median of its joints' distances from those that the person was given of this camera, at
    the nearest output frame, is at most a tenth of the diagonal of the body's box.

    ``times``: times of the camera's frames. ``camera``: position of the camera among the cameras of the observations.
    ``people``: tracks with the observations behind them.
    """
    frame = np.rint((times.time_s[detections.frame] - timebase.start_time_s) * timebase.frame_rate_hz).astype(int)
    size_px = np.linalg.norm(detections.box_px[:, 2:] - detections.box_px[:, :2], axis=1)
    is_free = np.ones(len(frame), bool)
    for track, observations in people:
        rows = frame - track.start_frame
        bodies = np.flatnonzero((rows >= 0) & (rows < len(observations.points_px)) & is_free)
        given_px = observations.points_px[rows[bodies], camera]
        apart_px = np.linalg.norm(detections.keypoints_px[bodies] - given_px, axis=-1)
        is_free[bodies[_median(apart_px) <= _NEAR * size_px[bodies]]] = False
    return is_free


def _median(values: Float[np.ndarray, "n joints"]) -> Float[np.ndarray, " n"]:
    """Medians of rows, without NaN; infinite where all are."""
    ordered = np.sort(values, axis=1)
    num_known = np.isfinite(values).sum(1)
    middle = ordered[np.arange(len(values)), np.maximum(num_known - 1, 0) // 2]
    return np.where(num_known > 0, middle, np.inf)
