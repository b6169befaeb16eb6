"""Small test videos, encoded by PyAV."""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np


def picture(number: int, size_px: tuple[int, int]) -> np.ndarray:
    """Draw a picture whose grey level and bright square encode its number."""
    width, height = size_px
    image = np.full((height, width, 3), 20 + 2 * number % 200, np.uint8)
    left = number * 3 % (width - 8)
    image[4:12, left : left + 8] = 255
    return image


@contextmanager
def keep_scheduling_policy() -> Iterator[None]:
    """Restore the policy of this thread: SVT-AV1, run as root, makes it and its child processes real-time."""
    policy = os.sched_getscheduler(0)
    try:
        yield
    finally:
        if os.sched_getscheduler(0) != policy:
            os.sched_setscheduler(0, policy, os.sched_param(0))


@keep_scheduling_policy()
def write_video(
    path: Path,
    num_frames: int = 30,
    size_px: tuple[int, int] = (64, 48),
    codec: str = "libx264",
    options: dict[str, str] | None = None,
    stamps: Sequence[int] | None = None,
    rate_hz: int | Fraction = 25,
    pix_fmt: str = "yuv420p",
) -> Path:
    """Encode ``num_frames`` pictures; ``stamps`` are their timestamps in 1/1000 s if the rate is not constant."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=rate_hz, options=options or {})
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height = size_px
        stream.pix_fmt = pix_fmt
        if stamps is not None:
            stream.codec_context.time_base = Fraction(1, 1000)
        for number in range(num_frames):
            frame = av.VideoFrame.from_ndarray(picture(number, size_px), format="rgb24")
            if stamps is not None:
                frame.pts, frame.time_base = stamps[number], Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def write_pictures(path: Path, pictures: Sequence[np.ndarray], options: dict[str, str] | None = None) -> Path:
    """Encode given pictures at 25 Hz."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25, options=options or {})
        assert isinstance(stream, av.VideoStream)
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        for image in pictures:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode())
    return path


def write_sizes(
    path: Path, sizes_px: Sequence[tuple[int, int]], frames_each: int, codec: str, options: dict[str, str] | None = None
) -> Path:
    """Encode a stream whose picture size changes, as after a restart of a camera."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25, options=options or {})
        assert isinstance(stream, av.VideoStream)
        (stream.width, stream.height), stream.pix_fmt = sizes_px[0], "yuv420p"
        for part, size_px in enumerate(sizes_px):
            encoder = av.CodecContext.create(codec, "w")
            assert isinstance(encoder, av.VideoCodecContext)
            (encoder.width, encoder.height), encoder.pix_fmt = size_px, "yuv420p"
            encoder.time_base, encoder.framerate, encoder.options = Fraction(1, 25), Fraction(25), options or {}
            packets = []
            for number in range(part * frames_each, (part + 1) * frames_each):
                frame = av.VideoFrame.from_ndarray(picture(number, size_px), format="rgb24")
                frame.pts, frame.time_base = number, Fraction(1, 25)
                packets += encoder.encode(frame)
            for packet in [*packets, *encoder.encode(None)]:
                packet.stream, packet.time_base = stream, Fraction(1, 25)
                container.mux(packet)
    return path


def rewrite_packets(
    source: Path,
    target: Path,
    change: Callable[[int, "av.Packet[Any]"], "Iterable[av.Packet[Any]]"],
) -> Path:
    """Copy a video packet by packet; ``change`` gives the packets that replace the k-th packet."""
    with av.open(str(source)) as reader, av.open(str(target), "w") as writer:
        stream = writer.add_stream_from_template(reader.streams.video[0])
        packets = [packet for packet in reader.demux(video=0) if packet.size]
        for number, packet in enumerate(packets):
            for changed in change(number, packet):
                changed.stream = stream
                writer.mux(changed)
    return target


def cut_at_keyframes(source: Path, targets: Sequence[Path], num_keyframes: int = 1) -> list[Path]:
    """Cut a video without encoding it again, as cameras cut chapters: each file has some keyframes, the last the rest.

    The pictures before a keyframe must not need those after it (closed groups of pictures).
    """
    with av.open(str(source)) as reader:
        stream = reader.streams.video[0]
        groups: list[list[av.Packet[Any]]] = []
        for packet in reader.demux(stream):
            if packet.size:
                if packet.is_keyframe:
                    groups.append([])
                groups[-1].append(packet)
        for number, target in enumerate(targets):
            first = number * num_keyframes
            last = len(groups) if target is targets[-1] else first + num_keyframes
            packets = [packet for group in groups[first:last] for packet in group]
            start = packets[0].pts or 0
            with av.open(str(target), "w") as writer:
                copy = writer.add_stream_from_template(stream)
                for packet in packets:
                    assert packet.pts is not None
                    assert packet.dts is not None
                    packet.pts, packet.dts, packet.stream = packet.pts - start, packet.dts - start, copy
                    writer.mux(packet)
    return list(targets)


def write_audio(path: Path) -> Path:
    """Encode a file with sound and without pictures."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("aac", rate=44100)
        assert isinstance(stream, av.AudioStream)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 44100), np.float32), format="fltp", layout="mono")
        frame.sample_rate = 44100
        container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def add_sound(source: Path, target: Path) -> Path:
    """Copy a video, with a silent track of sound between its pictures."""
    with av.open(str(source)) as reader, av.open(str(target), "w") as writer:
        pictures = writer.add_stream_from_template(reader.streams.video[0])
        sound = writer.add_stream("aac", rate=44100)
        assert isinstance(sound, av.AudioStream)
        packets = [packet for packet in reader.demux(video=0) if packet.size]
        for packet in packets:
            packet.stream = pictures
        for number in range(100):
            frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), format="fltp", layout="mono")
            frame.sample_rate, frame.pts = 44100, 1024 * number
            packets += sound.encode(frame)
        for packet in sorted([*packets, *sound.encode(None)], key=_time_s):
            writer.mux(packet)
    return target


def _time_s(packet: "av.Packet[Any]") -> float:
    return float((packet.dts or 0) * packet.time_base)
