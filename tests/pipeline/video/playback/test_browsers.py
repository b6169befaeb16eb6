"""Videos that browsers play, told by files of each kind."""

from pathlib import Path
from typing import Any

import pytest

from pipeline.video.info import VideoInfo
from pipeline.video.probe import VideoFormat, browser_media_type, probe
from tests.pipeline.media import write_video

MP4 = "mov,mp4,m4a,3gp,3g2,mj2"


@pytest.mark.parametrize(
    ("name", "choices", "media_type"),
    [
        ("a.mp4", {}, "video/mp4"),
        ("a.mp4", {"pix_fmt": "yuvj420p"}, "video/mp4"),
        ("a.webm", {"codec": "libvpx"}, "video/webm"),
        ("a.webm", {"codec": "libvpx-vp9"}, "video/webm"),
        ("a.mov", {}, None),
        ("a.mkv", {}, None),
        ("a.avi", {"codec": "mjpeg", "pix_fmt": "yuvj420p"}, None),
        ("a.ts", {}, None),
        ("a.mkv", {"codec": "libvpx-vp9"}, None),
        ("a.mp4", {"codec": "libx265", "options": {"x265-params": "log-level=none"}}, None),
        ("a.mp4", {"codec": "mpeg4"}, None),
        ("a.mov", {"codec": "prores_ks", "pix_fmt": "yuv422p10le"}, None),
        ("a.mp4", {"pix_fmt": "yuv420p10le"}, None),
        ("a.mp4", {"pix_fmt": "yuv444p"}, None),
        ("a.mp4", {"options": {"qp": "0"}}, None),
    ],
)
def test_files(tmp_path: Path, name: str, choices: dict[str, Any], media_type: str | None) -> None:
    found = probe(write_video(tmp_path / name, 5, **choices))
    assert isinstance(found, VideoInfo)
    assert found.browser_media_type == media_type


@pytest.mark.parametrize(
    ("size_px", "media_type"),
    [((4096, 2304), "video/mp4"), ((2304, 4096), "video/mp4"), ((4098, 2000), None), ((3600, 2800), None)],
)
def test_sizes(size_px: tuple[int, int], media_type: str | None) -> None:
    assert browser_media_type(VideoFormat(MP4, "isom", "h264", "High", "yuv420p", size_px)) == media_type


def test_clock_of_file_is_told(tmp_path: Path) -> None:
    found = probe(write_video(tmp_path / "a.mp4", 5, stamps=[400, 440, 480, 520, 560]))
    assert isinstance(found, VideoInfo)
    assert found.media_start_s == pytest.approx(0.4)
    assert found.time_s[0] == 0.0
