"""Videos that browsers play. Neither NumPy nor FFmpeg is loaded."""

from typing import NamedTuple

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
