"""Examine a sequence of images; called in a child process only."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.core.errors import UnusableError
from pipeline.core.problems.session_codes import NO_FRAMES, VIDEO_CHANGES_SIZE
from pipeline.video.frame_rate import uneven_times, without_rounding
from pipeline.video.images.files import SEQUENCE, open_images
from pipeline.video.info import VideoInfo

_NUM_DECODED = 8


def probe_images(path: Path) -> VideoInfo:
    """Examine a sequence: its first images and the last one are decoded.

    The times of the frames are their numbers until ``at_rate`` places them. Raises ``UnusableError`` if there are no
    images that can be decoded, or images of several sizes.
    """
    with open_images(path) as images:
        pts = np.array(images.frames, np.int64)
    chosen = {*pts[:_NUM_DECODED].tolist(), int(pts[-1])}
    # These load FFmpeg, which only this needs.
    from pipeline.video.images.frames import decode_images  # noqa: PLC0415
    from pipeline.video.orientation import display_orientation, mirrored  # noqa: PLC0415

    frames = list(decode_images(path, chosen.__contains__))
    if not frames:
        raise UnusableError(NO_FRAMES, "No image can be decoded.", "Send JPEG, PNG, BMP or TIFF.")
    first = frames[0]
    for frame in frames:
        if (frame.width, frame.height) != (first.width, first.height):
            raise UnusableError(
                VIDEO_CHANGES_SIZE,
                f"The images change their size from {first.width} x {first.height} to {frame.width} x {frame.height} "
                "pixels.",
                "Send images of one size.",
            )
        if display_orientation(frame) != display_orientation(first):
            raise UnusableError(
                VIDEO_CHANGES_SIZE,
                "The images are not all turned or mirrored alike for display (EXIF orientation).",
                "Send images of one orientation.",
            )
    width, height = frames[0].width, frames[0].height
    rotation_deg, is_mirrored = display_orientation(frames[0])
    return VideoInfo(
        path=path,
        codec=SEQUENCE,
        size_px=(width, height) if rotation_deg % 180 == 0 else (height, width),
        rotation_deg=rotation_deg,
        is_mirrored=is_mirrored,
        pts=pts,
        keyframe_pts=pts,
        time_s=pts.astype(np.float64),
        frame_rate_hz=1.0,
        warnings=(replace(mirrored(), file=path.name),) if is_mirrored else (),
    )


def at_rate(images: VideoInfo, frame_rate_hz: float) -> VideoInfo:
    """Place the frames of a sequence at a frame rate; numbers that are left out are dropped frames."""
    time_s = images.pts / float(without_rounding(frame_rate_hz))
    warnings = (replace(warning, file=images.path.name) for warning in uneven_times(time_s))
    return replace(images, time_s=time_s, frame_rate_hz=frame_rate_hz, warnings=(*images.warnings, *warnings))
