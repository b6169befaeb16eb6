from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.core.errors import InputError
from pipeline.video.container import decode_from, display_pts
from pipeline.video.decode import decode
from pipeline.video.info import VideoInfo
from pipeline.video.probe import probe
from tests.cases import slow_but
from tests.pipeline.media import write_video

NUM_FRAMES = 48

KINDS: dict[str, dict[str, Any]] = {
    "b-frames": {"codec": "libx264", "options": {"bf": "3", "g": "12"}},
    "open-gop": {"codec": "libx264", "options": {"x264-params": "open-gop=1:bframes=3:keyint=10:min-keyint=10"}},
    "one-keyframe": {"codec": "libx264", "options": {"g": "250"}},
    "mpeg4": {"codec": "mpeg4", "options": {"g": "7", "bf": "2"}},
    "variable-rate": {
        "codec": "libx264",
        "options": {"g": "9"},
        "stamps": [500 + 40 * k + (13 if k % 3 else 0) + (400 if k > 20 else 0) for k in range(NUM_FRAMES)],
    },
}


@pytest.fixture(scope="module", params=KINDS)
def video(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> VideoInfo:
    folder = tmp_path_factory.mktemp("video")
    ending = "mkv" if request.param == "variable-rate" else "mp4"
    found = probe(write_video(folder / f"clip.{ending}", NUM_FRAMES, **KINDS[request.param]))
    assert isinstance(found, VideoInfo)
    return found


@cache
def straight(path: Path) -> list[np.ndarray]:
    """Decode all pictures by PyAV alone."""
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


def pictures(video: VideoInfo, start_frame: int, stop_frame: int) -> list[tuple[int, np.ndarray]]:
    return [(number, image_rgb.copy()) for number, image_rgb in decode(video, start_frame, stop_frame)]


@pytest.mark.slow
@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(borders=st.lists(st.integers(0, NUM_FRAMES), max_size=5))
def test_any_cut_gives_every_frame_once_and_unchanged(video: VideoInfo, borders: list[int]) -> None:
    edges = [0, *sorted(borders), NUM_FRAMES]
    found = [pair for start, stop in pairwise(edges) for pair in pictures(video, start, stop)]
    assert [number for number, _ in found] == list(range(NUM_FRAMES))
    for (_, image_rgb), expected in zip(found, straight(video.path), strict=True):
        np.testing.assert_array_equal(image_rgb, expected)


def test_range_beyond_end_gives_what_there_is(video: VideoInfo) -> None:
    assert [number for number, _ in decode(video, NUM_FRAMES - 2, NUM_FRAMES + 10)] == [NUM_FRAMES - 2, NUM_FRAMES - 1]
    assert list(decode(video, 5, 5)) == []


@pytest.mark.parametrize("chosen", [[0], [3, 4, 30], [NUM_FRAMES - 1, 7, 7, NUM_FRAMES + 3]])
def test_chosen_frames_alone_are_given(video: VideoInfo, chosen: list[int]) -> None:
    damaged: list[int] = []
    found = [(number, image_rgb.copy()) for number, image_rgb in decode(video, 0, 99, damaged.append, only=chosen)]
    assert [number for number, _ in found] == sorted({number for number in chosen if number < NUM_FRAMES})
    for number, image_rgb in found:
        np.testing.assert_array_equal(image_rgb, straight(video.path)[number])
    assert damaged == []


def test_frames_that_no_wanted_frame_refers_to_are_not_decoded(tmp_path: Path) -> None:
    path = write_video(tmp_path / "b.mp4", NUM_FRAMES, options={"bf": "3", "g": "250", "b-adapt": "0"})
    whole = [pts for frame in decode_from(path, [], 0) if (pts := display_pts(frame)) is not None]
    wanted = {whole[5], whole[6], whole[NUM_FRAMES - 1]}
    some = [display_pts(frame) for frame in decode_from(path, [], 0, wanted)]
    assert wanted <= set(some) < set(whole)
    assert len(some) < 0.8 * NUM_FRAMES
    video = probe(path)
    assert isinstance(video, VideoInfo)
    for number, image_rgb in decode(video, 0, NUM_FRAMES, only=[5, 6, NUM_FRAMES - 1]):
        np.testing.assert_array_equal(image_rgb, straight(path)[number])


def test_keyframes_alone_are_decoded(video: VideoInfo) -> None:
    keyframes = np.flatnonzero(np.isin(video.pts, video.keyframe_pts)).tolist()
    found = [(number, image_rgb.copy()) for number, image_rgb in decode(video, 0, NUM_FRAMES, only=keyframes)]
    assert [number for number, _ in found] == keyframes
    for number, image_rgb in found:
        np.testing.assert_array_equal(image_rgb, straight(video.path)[number])


CONTAINERS: dict[str, dict[str, Any]] = {
    "h264.ts": {"codec": "libx264", "options": {"bf": "2", "g": "12"}},
    "h264.mkv": {"codec": "libx264", "options": {"bf": "2", "g": "12"}},
    "hevc.mp4": {"codec": "libx265", "options": {"x265-params": "keyint=12:bframes=4:open-gop=1:log-level=0"}},
    "mpeg2.ts": {"codec": "mpeg2video", "options": {"bf": "2", "g": "12"}},
    "mpeg2.mpg": {"codec": "mpeg2video", "options": {"bf": "2", "g": "12"}},
    "mpeg4.avi": {"codec": "mpeg4", "options": {"bf": "2", "g": "12"}},
    "vp8.webm": {"codec": "libvpx", "options": {"g": "12", "deadline": "realtime"}},
    "vp9.mp4": {"codec": "libvpx-vp9", "options": {"g": "12", "deadline": "realtime"}},
    "av1.mkv": {"codec": "libsvtav1", "options": {"g": "12", "preset": "12"}},
    "ffv1.mkv": {"codec": "ffv1", "options": {"g": "12"}},
    "mjpeg.avi": {"codec": "mjpeg", "pix_fmt": "yuvj420p"},
    "prores.mov": {"codec": "prores_ks", "pix_fmt": "yuv422p10le"},
}
QUICK = ("h264.ts", "hevc.mp4", "mpeg2.mpg", "mpeg4.avi", "vp9.mp4", "av1.mkv")


@pytest.mark.parametrize("name", slow_but(QUICK, CONTAINERS))
def test_every_container_can_be_entered_in_middle(tmp_path: Path, name: str) -> None:
    found = probe(write_video(tmp_path / name, NUM_FRAMES, **CONTAINERS[name]))
    assert isinstance(found, VideoInfo)
    expected = straight(found.path)
    assert found.num_frames == len(expected) == NUM_FRAMES
    for start, stop in ((17, 20), (NUM_FRAMES - 5, NUM_FRAMES)):
        numbers, images = zip(*pictures(found, start, stop), strict=True)
        assert list(numbers) == list(range(start, stop))
        np.testing.assert_array_equal(images, expected[start:stop])


def test_pictures_whose_rows_are_padded(tmp_path: Path) -> None:
    """The width is not a multiple of any alignment."""
    found = probe(write_video(tmp_path / "clip.mp4", 3, size_px=(70, 46)))
    assert isinstance(found, VideoInfo)
    for (_, image_rgb), expected in zip(pictures(found, 0, 3), straight(found.path), strict=True):
        np.testing.assert_array_equal(image_rgb, expected)


def test_file_replaced_after_probe_is_named(tmp_path: Path) -> None:
    info = probe(write_video(tmp_path / "clip.mp4", NUM_FRAMES))
    assert isinstance(info, VideoInfo)
    info.path.write_bytes(bytes(6000))
    with pytest.raises(InputError) as error:
        list(decode(info, 0, NUM_FRAMES))
    (problem,) = error.value.problems
    assert (problem.code, problem.file) == ("video_damaged", "clip.mp4")
