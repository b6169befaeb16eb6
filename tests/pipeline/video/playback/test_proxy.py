"""Proxies: frames, times, sizes and rotation of what browsers play, made of what they don't."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from pipeline.core.errors import InputError
from pipeline.video.decode import decode
from pipeline.video.info import VideoInfo
from pipeline.video.playback.proxy import make_proxy_in_child, proxy_size_px
from pipeline.video.probe import probe
from tests.pipeline.media import write_video

SIZE_PX = (64, 48)


def probed(path: Path) -> VideoInfo:
    found = probe(path)
    assert isinstance(found, VideoInfo), found
    return found


def make(video: VideoInfo, path: Path, time_s: np.ndarray | None = None) -> tuple[VideoInfo, int]:
    """Make a proxy; its properties, and the number of frames that were reported."""
    reported: list[None] = []
    make_proxy_in_child(video, video.time_s if time_s is None else time_s, path, lambda: reported.append(None))
    return probed(path), len(reported)


def squares(video: VideoInfo) -> list[int]:
    """Left edges of the bright square of each frame, which tell the frames apart."""
    return [int(np.argmax(image[8, :, 0] > 180)) for _, image in decode(video, 0, video.num_frames)]


@pytest.mark.parametrize(
    ("name", "choices"),
    [
        ("a.mkv", {"codec": "libx265", "options": {"x265-params": "log-level=none:bframes=3"}}),
        ("a.mov", {"codec": "prores_ks", "pix_fmt": "yuv422p10le"}),
        ("a.avi", {"codec": "mjpeg", "pix_fmt": "yuvj420p"}),
        ("a.mp4", {"pix_fmt": "yuv420p10le", "options": {"bf": "3"}}),
    ],
)
def test_unplayable_video_becomes_playable(tmp_path: Path, name: str, choices: dict[str, Any]) -> None:
    video = probed(write_video(tmp_path / name, 40, SIZE_PX, **choices))
    assert video.browser_media_type is None
    proxy, num_reported = make(video, tmp_path / "proxy.mp4")
    assert (proxy.browser_media_type, proxy.media_start_s, proxy.size_px) == ("video/mp4", 0.0, SIZE_PX)
    assert num_reported == proxy.num_frames == 40
    np.testing.assert_allclose(proxy.time_s, video.time_s, atol=1.1e-5)
    np.testing.assert_allclose(squares(proxy), squares(video), atol=2)


def test_true_times_are_kept(tmp_path: Path) -> None:
    stamps = [0, 33, 67, 100, 250, 251, 900, 933]
    video = probed(write_video(tmp_path / "a.mkv", len(stamps), stamps=stamps))
    proxy, _ = make(video, tmp_path / "proxy.mp4")
    np.testing.assert_allclose(proxy.time_s, np.array(stamps) / 1000.0, atol=1e-5)
    assert squares(proxy) == squares(video)


def test_times_that_client_has_stated_take_place_of_wrong_ones(tmp_path: Path) -> None:
    video = probed(write_video(tmp_path / "a.mp4", 20))
    proxy, _ = make(video, tmp_path / "proxy.mp4", 7.5 + np.arange(20) / 120.0)
    np.testing.assert_allclose(proxy.time_s, np.arange(20) / 120.0, atol=1e-5)


def test_keyframes_have_constant_distance_and_index_comes_first(tmp_path: Path) -> None:
    video = probed(write_video(tmp_path / "a.mkv", 100, options={"g": "250"}))
    proxy, _ = make(video, tmp_path / "proxy.mp4")
    assert np.diff(np.searchsorted(proxy.pts, proxy.keyframe_pts)).tolist() == [12] * 8
    content = (tmp_path / "proxy.mp4").read_bytes()
    assert content.find(b"moov") < content.find(b"mdat")


def test_sound_is_left_out_and_large_pictures_are_scaled(tmp_path: Path) -> None:
    video = probed(write_video(tmp_path / "a.mkv", 3, (1922, 1080)))
    make(video, tmp_path / "proxy.mp4")
    with av.open(str(tmp_path / "proxy.mp4")) as container:
        assert [stream.type for stream in container.streams] == ["video"]
        assert (container.streams.video[0].width, container.streams.video[0].height) == (960, 540)


@pytest.mark.parametrize(
    ("size_px", "expected"),
    [((1920, 1080), (960, 540)), ((1080, 1920), (540, 960)), ((640, 481), (640, 480)), ((4000, 10), (960, 2))],
)
def test_sizes(size_px: tuple[int, int], expected: tuple[int, int]) -> None:
    assert proxy_size_px(size_px) == expected


@pytest.mark.parametrize(
    ("rotation_deg", "is_mirrored"), [(90, False), (180, False), (270, False), (0, True), (90, True)]
)
def test_pictures_are_mirrored_and_turned(tmp_path: Path, rotation_deg: int, is_mirrored: bool) -> None:
    video = probed(write_video(tmp_path / "a.mkv", 2, SIZE_PX))
    size_px = SIZE_PX if rotation_deg % 180 == 0 else SIZE_PX[::-1]
    turned = replace(video, rotation_deg=rotation_deg, is_mirrored=is_mirrored, size_px=size_px)
    proxy, _ = make(turned, tmp_path / "proxy.mp4")
    assert (proxy.size_px, proxy.rotation_deg) == (size_px, 0)
    (_, shown), (_, made) = next(decode(turned, 0, 1)), next(decode(proxy, 0, 1))
    assert np.mean(np.abs(shown.astype(float) - made)) < 4.0


def test_file_that_is_damaged_is_named(tmp_path: Path) -> None:
    video = probed(write_video(tmp_path / "a.mkv", 30))
    video.path.write_bytes(b"\x1aE\xdf\xa3" + bytes(1000))
    with pytest.raises(InputError) as caught:
        make(video, tmp_path / "proxy.mp4")
    assert [(problem.code, problem.file) for problem in caught.value.problems] == [("video_damaged", "a.mkv")]


def test_child_ends_with_caller_s_interest(tmp_path: Path) -> None:
    video = probed(write_video(tmp_path / "a.mkv", 200))
    frames: list[None] = []

    def stop_after_three() -> None:
        frames.append(None)
        if len(frames) == 3:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        make_proxy_in_child(video, video.time_s, tmp_path / "proxy.mp4", stop_after_three)
    assert len(frames) == 3


def test_proxy_above_mebibyte_is_written_whole(tmp_path: Path) -> None:
    noise = np.random.default_rng(1).integers(0, 256, (20, 480, 640, 3), np.uint8)
    path = tmp_path / "noise.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mjpeg", rate=20)
        stream.width, stream.height, stream.pix_fmt = 640, 480, "yuvj420p"
        for image in noise:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode(None))
    proxy, num_reported = make(probed(path), tmp_path / "proxy.mp4")
    assert (tmp_path / "proxy.mp4").stat().st_size > 2**20
    assert num_reported == proxy.num_frames == 20
