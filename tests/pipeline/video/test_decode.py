from itertools import pairwise
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.errors import InputError
from pipeline.video.decode import decode
from pipeline.video.info import VideoInfo
from pipeline.video.probe import probe
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


def straight(video: VideoInfo) -> list[np.ndarray]:
    """All pictures by PyAV alone."""
    with av.open(str(video.path)) as container:
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(borders=st.lists(st.integers(0, NUM_FRAMES), max_size=5))
def test_any_cut_gives_every_frame_once_and_unchanged(video: VideoInfo, borders: list[int]) -> None:
    edges = [0, *sorted(borders), NUM_FRAMES]
    found = [pair for start, stop in pairwise(edges) for pair in decode(video, start, stop)]
    assert [number for number, _ in found] == list(range(NUM_FRAMES))
    for (_, image_rgb), expected in zip(found, straight(video), strict=True):
        np.testing.assert_array_equal(image_rgb, expected)


def test_a_range_beyond_the_end_gives_what_there_is(video: VideoInfo) -> None:
    assert [number for number, _ in decode(video, NUM_FRAMES - 2, NUM_FRAMES + 10)] == [NUM_FRAMES - 2, NUM_FRAMES - 1]
    assert list(decode(video, 5, 5)) == []


def test_a_file_damaged_after_the_probe_is_named(tmp_path: Path) -> None:
    info = probe(write_video(tmp_path / "clip.mp4", NUM_FRAMES, options={"g": "4"}))
    assert isinstance(info, VideoInfo)
    content = bytearray(info.path.read_bytes())
    start = content.find(b"mdat") + 400
    content[start : start + 6000] = bytes(6000)
    info.path.write_bytes(content)
    with pytest.raises(InputError) as error:
        list(decode(info, 0, NUM_FRAMES))
    (problem,) = error.value.problems
    assert (problem.code, problem.file) == ("video_damaged", "clip.mp4")
