"""Timecode and times of creation: numbers by SMPTE 12M, and files that PyAV and ffmpeg write."""

import re
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import pytest

from pipeline.video.info import VideoInfo
from pipeline.video.probe import probe
from pipeline.video.properties.container_clocks import created_s, timecode_rate, timecode_s
from tests.pipeline.media import picture

NTSC = Fraction(30000, 1001)


@pytest.mark.parametrize(
    ("text", "rate", "frames"),
    [
        ("00:00:00:00", Fraction(25), 0),
        ("10:00:00:12", Fraction(25), 900_012),
        ("01:00:00:00", Fraction(24000, 1001), 86_400),
        ("00:00:59;29", NTSC, 1799),
        ("00:01:00;02", NTSC, 1800),  # numbers 00 and 01 are dropped
        ("00:02:00;02", NTSC, 3598),
        ("00:10:00;00", NTSC, 17_982),  # not in each tenth minute
        ("01:00:00;00", NTSC, 107_892),
        ("23:59:59;29", NTSC, 2_589_407),
        ("01:00:00:00", NTSC, 108_000),
        ("00:01:00;04", Fraction(60000, 1001), 3600),
        ("01:00:00.00", Fraction(60000, 1001), 215_784),
        ("01:00:00;00", Fraction(25), 90_000),  # nothing is dropped at 25 Hz
    ],
)
def test_timecode_counts_frames(text: str, rate: Fraction, frames: int) -> None:
    assert timecode_s(text, rate) == float(frames / rate)


@pytest.mark.parametrize("text", ["", "1:2:3:4", "24:00:00:00", "00:60:00:00", "00:00:00:25", "00:00:00", "\u0661" * 8])
def test_malformed_timecode_is_none(text: str) -> None:
    assert timecode_s(text, Fraction(25)) is None


@pytest.mark.parametrize("rate", [Fraction(1, 2), Fraction(10**6)])
def test_implausible_rates_are_refused(rate: Fraction) -> None:
    assert timecode_s("00:00:00:00", rate) is None


def test_creation_times() -> None:
    assert created_s({"creation_time": "2024-05-01T10:00:03.000000Z"}) == 1_714_557_603.0
    assert created_s({"creation_time": "2024-05-01T12:00:03.5+02:00"}) == 1_714_557_603.5
    for text in ("", "1904-01-01T00:00:00.000000Z", "1970-01-01T00:00:00Z", "yesterday", "2024-05-01T10:00:03"):
        assert created_s({"creation_time": text}) is None


def write(path: Path, rate: Fraction, **metadata: str) -> Path:
    with av.open(str(path), "w") as container:
        container.metadata.update(metadata)
        stream = container.add_stream("libx264", rate=rate, options={"bf": "2"})
        assert isinstance(stream, av.VideoStream)
        (stream.width, stream.height), stream.pix_fmt = (64, 48), "yuv420p"
        for number in range(20):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture(number, (64, 48)), format="rgb24")))
        container.mux(stream.encode())
    return path


def found(path: Path) -> VideoInfo:
    video = probe(path)
    assert isinstance(video, VideoInfo), video
    return video


@pytest.mark.parametrize("name", ["a.mov", "a.mp4", "a.mkv"])
def test_drop_frame_timecode_and_creation_time_of_file(tmp_path: Path, name: str) -> None:
    path = write(tmp_path / name, NTSC, timecode="01:00:00;02", creation_time="2024-05-01T10:00:03Z")
    video = found(path)
    assert video.timecode is not None
    assert video.timecode.time_s == pytest.approx(107_894 * 1001 / 30_000, abs=1e-9)
    assert video.timecode.rate_hz == float(NTSC)
    assert video.created_s == 1_714_557_603.0


def test_file_without_clocks(tmp_path: Path) -> None:
    video = found(write(tmp_path / "a.mp4", Fraction(25)))
    assert (video.timecode, video.created_s) == (None, None)
    assert timecode_rate(tmp_path / "a.mp4") is None


def edited(path: Path, target: Path, change: Any) -> Path:
    content = bytearray(path.read_bytes())
    entry = re.search(rb"stsd.{12}(tmcd)", content, re.DOTALL)
    assert entry is not None
    change(content, entry.start(1))
    target.write_bytes(content)
    return target


def test_rate_of_timecode_may_be_half_rate_of_video(tmp_path: Path) -> None:
    """A camera of 59.94 Hz whose timecode counts at 29.97 Hz."""

    def halve(content: bytearray, entry: int) -> None:
        duration = int.from_bytes(content[entry + 24 : entry + 28])
        content[entry + 24 : entry + 28] = (2 * duration).to_bytes(4)

    path = write(tmp_path / "a.mov", Fraction(60000, 1001), timecode="00:01:00;04")
    assert timecode_rate(path) == Fraction(60000, 1001)
    changed = edited(path, tmp_path / "b.mov", halve)
    assert timecode_rate(changed) == NTSC
    timecode = found(changed).timecode
    assert timecode is not None
    assert timecode.rate_hz == float(NTSC)


@pytest.mark.parametrize("size", [0, 1, 7, 2**31, 2**32 - 1])
def test_headers_of_wrong_sizes_have_no_rate(tmp_path: Path, size: int) -> None:
    path = write(tmp_path / "a.mov", NTSC, timecode="01:00:00;02")
    content = bytearray(path.read_bytes())
    start = content.index(b"moov") - 4
    content[start : start + 4] = size.to_bytes(4)
    path.write_bytes(content)
    assert timecode_rate(path) in {None, NTSC}
