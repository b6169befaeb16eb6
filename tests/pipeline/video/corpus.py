"""Small videos of the formats that cameras, phones and editors write, made by PyAV's encoders.

Each clip states what a reader must find: the size as shown, the turn, the numbers of the pictures and their times.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.video.reformatter import ColorRange

from tests.pipeline.media import keep_scheduling_policy

NUM_FRAMES = 40
_X264_LONG = {"g": "250", "bf": "3", "sc_threshold": "0"}


@dataclass(frozen=True)
class CorpusClip:
    """A video to encode, and what it must look like.

    Parameters
    ----------
    codec, pix_fmt, options, muxer
        Encoder, its pixel format and its options; options of the container.
    size_px
        Size of the stored pictures.
    shown_px
        Size as shown; ``None``: as stored.
    rotation_deg
        Counterclockwise turn for display.
    stamps
        Times of the frames in 1/1000 s; ``None``: a constant rate.
    gaps
        Whether the times have gaps.
    shown
        Numbers of the pictures that are shown; ``None``: all.
    """

    codec: str = "libx264"
    pix_fmt: str = "yuv420p"
    options: Mapping[str, str] = field(default_factory=dict)
    muxer: Mapping[str, str] = field(default_factory=dict)
    size_px: tuple[int, int] = (96, 64)
    shown_px: tuple[int, int] | None = None
    rotation_deg: int = 0
    pixel_aspect: Fraction | None = None
    is_full_range: bool = False
    is_interlaced: bool = False
    rate_hz: int | Fraction = 25
    stamps: Sequence[int] | None = None
    shown: Sequence[int] | None = None
    gaps: bool = False

    @property
    def expected_px(self) -> tuple[int, int]:
        """Size as shown."""
        return self.shown_px or self.size_px

    @property
    def pictures(self) -> Sequence[int]:
        """Numbers of the pictures that are shown, in their order."""
        return range(NUM_FRAMES) if self.shown is None else self.shown

    @property
    def time_s(self) -> np.ndarray:
        """Times of the shown frames, the first is 0."""
        numbers = np.array(self.pictures)
        times = numbers / float(self.rate_hz) if self.stamps is None else np.array(self.stamps)[numbers] / 1000
        found: np.ndarray = times - times[0]
        return found


def _hevc(**parameters: object) -> dict[str, str]:
    return {"x265-params": ":".join(f"{name.replace('_', '-')}={value}" for name, value in parameters.items())}


_VFR = [700 + 33 * k + (k * k) % 11 + (260 if k > 15 else 0) + (1900 if k > 30 else 0) for k in range(NUM_FRAMES)]
_INTERLACED = {"flags": "+ildct+ilme", "x264-params": "tff=1", "g": "12"}

CLIPS: Mapping[str, CorpusClip] = {
    "h264-b-frames.mp4": CorpusClip(options={"bf": "3", "g": "12"}),
    "h264-b-pyramid.mkv": CorpusClip(options={"x264-params": "bframes=7:b-pyramid=normal:b-adapt=0:keyint=20"}),
    "h264-open-gop.mp4": CorpusClip(options={"x264-params": "open-gop=1:bframes=3:keyint=10:min-keyint=10"}),
    "h264-open-gop.mkv": CorpusClip(options={"x264-params": "open-gop=1:bframes=3:keyint=10:min-keyint=10"}),
    "h264-long-gop.mov": CorpusClip(options=_X264_LONG),
    "h264-intra-refresh.mp4": CorpusClip(options={"x264-params": "intra-refresh=1:keyint=12:bframes=0"}),
    "h264-no-b-frames.avi": CorpusClip(options={"bf": "0", "g": "12"}),
    "h264-fragmented.mp4": CorpusClip(options={"g": "8", "bf": "2"}, muxer={"movflags": "frag_keyframe+empty_moov"}),
    "h264-baseline.m4v": CorpusClip(options={"profile": "baseline", "g": "15"}),
    "h264-422-10.mov": CorpusClip(pix_fmt="yuv422p10le", options={"g": "10", "bf": "2"}),
    "h264-444.mkv": CorpusClip(pix_fmt="yuv444p", options={"g": "10"}),
    "h264-full-range.mp4": CorpusClip(options={"g": "10"}, is_full_range=True),
    "h264-interlaced.mp4": CorpusClip(options=_INTERLACED, is_interlaced=True),
    "h264-29.97.mp4": CorpusClip(rate_hz=Fraction(30000, 1001), options={"g": "15", "bf": "2"}),
    "h264-59.94.mov": CorpusClip(rate_hz=Fraction(60000, 1001), options={"g": "15", "bf": "2"}),
    "h264-23.976.mkv": CorpusClip(rate_hz=Fraction(24000, 1001), options={"g": "15", "bf": "2"}),
    "h264-variable.mp4": CorpusClip(stamps=_VFR, gaps=True, options={"g": "9", "bf": "2"}),
    "h264-variable.mkv": CorpusClip(stamps=_VFR, gaps=True, options={"g": "9", "bf": "2"}),
    "h264-rotated-90.mp4": CorpusClip(rotation_deg=90, shown_px=(64, 96), options={"g": "9", "bf": "2"}),
    "h264-rotated-180.mov": CorpusClip(rotation_deg=180, options={"g": "9", "bf": "2"}),
    "hevc-rotated-270.mp4": CorpusClip(
        "libx265", rotation_deg=270, shown_px=(64, 96), options=_hevc(keyint=12, bframes=3)
    ),
    "h264-wide-pixels.mp4": CorpusClip(pixel_aspect=Fraction(4, 3), shown_px=(128, 64), options={"g": "9", "bf": "2"}),
    "h264-narrow-pixels.mkv": CorpusClip(pixel_aspect=Fraction(8, 9), shown_px=(85, 64), options={"g": "9", "bf": "2"}),
    "h264-wide-pixels-rotated.mov": CorpusClip(
        pixel_aspect=Fraction(4, 3), rotation_deg=90, shown_px=(64, 128), options={"g": "9"}
    ),
    "h264-cut-by-edit-list.mp4": CorpusClip(options={"g": "12", "bf": "2"}, shown=range(7, NUM_FRAMES)),
    "h264-cut-after-keyframes.mov": CorpusClip(options={"g": "8", "bf": "2"}, shown=range(21, NUM_FRAMES)),
    "h264-late-start.mov": CorpusClip(options={"g": "12", "bf": "2"}, stamps=[480 + 40 * k for k in range(NUM_FRAMES)]),
    "hevc-8.mp4": CorpusClip("libx265", options=_hevc(keyint=12, bframes=4)),
    "hevc-10.mkv": CorpusClip("libx265", "yuv420p10le", _hevc(keyint=12, bframes=4)),
    "hevc-10-422.mov": CorpusClip("libx265", "yuv422p10le", _hevc(keyint=12, bframes=4)),
    "hevc-open-gop.mp4": CorpusClip("libx265", options=_hevc(keyint=10, min_keyint=10, bframes=4, open_gop=1)),
    "hevc-odd-size.mp4": CorpusClip("libx265", size_px=(93, 63), pix_fmt="yuv444p", options=_hevc(keyint=12)),
    "vp8.webm": CorpusClip("libvpx", options={"g": "12", "deadline": "realtime", "auto-alt-ref": "1"}),
    "vp9.webm": CorpusClip("libvpx-vp9", options={"g": "12", "deadline": "good", "cpu-used": "8", "auto-alt-ref": "1"}),
    "vp9-odd-size.webm": CorpusClip("libvpx-vp9", size_px=(95, 61), options={"g": "12", "deadline": "realtime"}),
    "vp9-live.webm": CorpusClip("libvpx-vp9", options={"g": "12", "deadline": "realtime"}, muxer={"live": "1"}),
    "av1.mp4": CorpusClip("libsvtav1", options={"g": "12", "preset": "12"}),
    "av1-10.webm": CorpusClip("libsvtav1", "yuv420p10le", {"g": "12", "preset": "12"}),
    "mjpeg.avi": CorpusClip("mjpeg", "yuvj420p", {"qmin": "1", "q": "2"}, is_full_range=True),
    "mjpeg-422-odd.mov": CorpusClip("mjpeg", "yuvj422p", size_px=(95, 61), is_full_range=True),
    "prores-422.mov": CorpusClip("prores_ks", "yuv422p10le", {"profile": "2"}),
    "prores-4444.mov": CorpusClip("prores_ks", "yuv444p10le", {"profile": "4"}),
    "prores-interlaced.mov": CorpusClip("prores_ks", "yuv422p10le", {"flags": "+ildct"}, is_interlaced=True),
    "dnxhr.mov": CorpusClip("dnxhd", "yuv422p", {"profile": "dnxhr_sq"}, size_px=(256, 128)),
    "mpeg4-b-frames.mp4": CorpusClip("mpeg4", options={"g": "12", "bf": "2"}),
    "mpeg2-interlaced.ts": CorpusClip(
        "mpeg2video", options={"g": "12", "bf": "2", "flags": "+ildct"}, is_interlaced=True
    ),
    "ffv1-rgb.mkv": CorpusClip("ffv1", "bgr0", {"g": "12"}, size_px=(95, 61)),
}


def picture(number: int, size_px: tuple[int, int]) -> np.ndarray:
    """Draw a picture with its number as the grey level of the left half, and a square that moves at the right."""
    width, height = size_px
    image = np.zeros((height, width, 3), np.uint8)
    image[:, : width // 2] = level(number)
    top = number * 3 % (height - 12)
    image[top : top + 12, 3 * width // 4 - 6 : 3 * width // 4 + 6] = (230, 60, 40)
    return image


def level(number: int) -> int:
    """Grey level of the left half of a picture."""
    return 24 + 5 * number


@keep_scheduling_policy()
def write_clip(folder: Path, name: str) -> Path:
    """Encode a clip."""
    clip, path = CLIPS[name], folder / name
    with av.open(str(path), "w", options=dict(clip.muxer)) as container:
        options = {"x265-params": "log-level=0", **clip.options}
        if clip.codec == "libx265":
            options["x265-params"] = f"{clip.options['x265-params']}:log-level=0"
        elif clip.codec != "libx265":
            options.pop("x265-params")
        stream = container.add_stream(clip.codec, rate=clip.rate_hz, options=options)
        assert isinstance(stream, av.VideoStream)
        (stream.width, stream.height), stream.pix_fmt = clip.size_px, clip.pix_fmt
        if clip.codec.startswith("mpeg"):
            stream.bit_rate = 3_000_000
        if clip.pixel_aspect:
            stream.codec_context.sample_aspect_ratio = clip.pixel_aspect
        if clip.is_full_range and clip.pix_fmt.startswith("yuv4"):
            stream.codec_context.color_range = ColorRange.JPEG.value
        if clip.rotation_deg:
            stream.set_display_rotation(clip.rotation_deg)
        if clip.stamps is not None:
            stream.codec_context.time_base = Fraction(1, 1000)
        for number in range(NUM_FRAMES):
            container.mux(_shifted(clip, stream.encode(_frame(clip, number))))
        container.mux(_shifted(clip, stream.encode()))
    return path


def _shifted(clip: CorpusClip, packets: "list[av.Packet[Any]]") -> "list[av.Packet[Any]]":
    """Move the frames before the shown ones to negative times, which the muxer cuts off by an edit list."""
    for packet in packets:
        if first := clip.pictures[0]:
            assert packet.pts is not None
            assert packet.dts is not None
            ticks = round(first / clip.rate_hz / packet.time_base)
            packet.pts, packet.dts = packet.pts - ticks, packet.dts - ticks
    return packets


def _frame(clip: CorpusClip, number: int) -> av.VideoFrame:
    frame = av.VideoFrame.from_ndarray(picture(number, clip.size_px), format="rgb24")
    if clip.is_full_range:
        frame = frame.reformat(format=clip.pix_fmt, dst_color_range=ColorRange.JPEG)
    if clip.stamps is not None:
        frame.pts, frame.time_base = clip.stamps[number], Fraction(1, 1000)
    return frame
