"""Small pictures: no more than allowed, at even times."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.capture.session import CaptureSession
from pipeline.core.data.cameras import FrameTimes, Timebase
from pipeline.core.data.detections import HeadRegions
from pipeline.core.progress import ignore
from pipeline.export.rerun.rerun_pictures import MAX_RATE_HZ, small_pictures, thinned
from pipeline.video.info import VideoInfo
from pipeline.video.probe import probe
from tests.pipeline.export.test_overlay import CAMERA
from tests.pipeline.media import write_pictures


@given(
    st.lists(st.floats(0.001, 1.0), min_size=1, max_size=60).map(np.cumsum),
    st.integers(1, 80),
)
def test_frames_are_no_more_than_allowed(time_s: np.ndarray, max_pictures: int) -> None:
    chosen = thinned(time_s, max_pictures)
    assert 1 <= len(chosen) <= max_pictures
    assert chosen[0] == 0
    assert (np.diff(chosen) > 0).all()
    assert len(chosen) <= (time_s[-1] - time_s[0]) * MAX_RATE_HZ + 1.01
    if max_pictures >= len(time_s) and (np.diff(time_s) > 1.1 / MAX_RATE_HZ).all():
        # A camera slower than the limit keeps all frames of its own, unless they are too many.
        assert len(chosen) <= len(time_s)


def test_frames_of_slow_camera_are_all_kept() -> None:
    assert thinned(np.arange(20) / 5.0, 1000).tolist() == list(range(20))


def noisy_session(folder: Path, num_frames: int) -> CaptureSession:
    """Session of a camera whose pictures can hardly be compressed."""
    rng = np.random.default_rng(0)
    width, height = CAMERA.size_px
    pictures = [rng.integers(0, 256, (height, width, 3), np.uint8) for _ in range(num_frames)]
    video = probe(write_pictures(folder / "front.mp4", pictures, {"crf": "1"}))
    assert isinstance(video, VideoInfo)
    return CaptureSession((CAMERA,), (video,), {"front": FrameTimes(np.arange(num_frames) / 10.0)}, ())


def test_heads_are_blurred(tmp_path: Path) -> None:
    session, timebase = noisy_session(tmp_path, 3), Timebase(0.0, 10.0, 3)
    ellipse_px = np.array([[320.0, 240.0, 60.0, 60.0]])
    heads = HeadRegions("front", CAMERA.size_px, 0, 3, np.array([1]), ellipse_px)
    plain, blurred = (
        [np.asarray(cv2.imdecode(np.frombuffer(picture.jpeg, np.uint8), cv2.IMREAD_COLOR)) for picture in pictures]
        for pictures in (
            small_pictures(session, timebase, "front", 2**30, ignore),
            small_pictures(session, timebase, "front", 2**30, ignore, heads),
        )
    )
    inner = slice(210, 271), slice(290, 351)
    assert blurred[1][inner].std() < 0.3 * plain[1][inner].std()
    np.testing.assert_array_equal(blurred[0], plain[0])


@pytest.mark.slow
def test_pictures_that_compress_badly_are_fewer(tmp_path: Path) -> None:
    session, timebase = noisy_session(tmp_path, 10), Timebase(0.0, 10.0, 10)
    all_of_them = list(small_pictures(session, timebase, "front", 2**30, ignore))
    assert len(all_of_them) == 10
    usual = len(all_of_them[0].jpeg)
    assert usual > 2**15
    max_bytes = 10 * 2**15
    kept = list(small_pictures(session, timebase, "front", max_bytes, ignore))
    assert 0 < len(kept) < 10
    assert sum(len(picture.jpeg) for picture in kept) <= max_bytes
    # They are spread over the take.
    assert kept[-1].time_s > 0.4
    assert list(small_pictures(session, timebase, "front", usual // 2, ignore)) == []
