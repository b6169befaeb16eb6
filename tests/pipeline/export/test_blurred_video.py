"""Videos and pictures with blurred heads, as they are encoded: nothing of a face is left, the rest is as before."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.capture.session import CaptureSession
from pipeline.core.data.cameras import FrameTimes, Timebase
from pipeline.core.data.heads import HeadRegions
from pipeline.export.blurred_video import write_blurred
from pipeline.export.overlay_video import draw_video
from pipeline.video.decode import decode
from pipeline.video.info import VideoInfo
from pipeline.video.probe import probe
from tests.pipeline.export.privacy.test_blur import detail, patterned
from tests.pipeline.export.test_overlay import CAMERA
from tests.pipeline.export.test_overlay_video import NUM_FRAMES, RATE_HZ, runner, take_of
from tests.pipeline.media import write_pictures

# A head that moves by 20 pixels a frame.
FRAMES = np.arange(NUM_FRAMES)
ELLIPSE_PX = np.stack(
    [160 + 20.0 * FRAMES, np.full(NUM_FRAMES, 100.0), np.full(NUM_FRAMES, 40.0), np.full(NUM_FRAMES, 50.0)], axis=1
)
HEADS = HeadRegions("front", CAMERA.size_px, 0, NUM_FRAMES, FRAMES, ELLIPSE_PX)


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> VideoInfo:
    picture = cv2.resize(patterned(), CAMERA.size_px)
    found = probe(write_pictures(tmp_path_factory.mktemp("video") / "front.mp4", [picture] * NUM_FRAMES))
    assert isinstance(found, VideoInfo)
    return found


def pictures(path: Path) -> dict[int, np.ndarray]:
    shown = probe(path)
    assert isinstance(shown, VideoInfo)
    assert shown.browser_media_type == "video/mp4"
    return {number: image.copy() for number, image in decode(shown, 0, len(shown.pts))}


def inner(image: np.ndarray, frame: int) -> np.ndarray:
    """Square in the middle of the head of a frame."""
    x_px = round(ELLIPSE_PX[frame, 0])
    return image[80:121, x_px - 20 : x_px + 21]


def test_heads_are_gone_from_the_encoded_video(video: VideoInfo, tmp_path: Path) -> None:
    path = tmp_path / "blurred.mp4"
    frames: list[None] = []
    write_blurred(video, video.time_s, range(NUM_FRAMES), HEADS, path, lambda: frames.append(None))
    before = {number: image.copy() for number, image in decode(video, 0, NUM_FRAMES)}
    after = pictures(path)
    assert len(after) == len(frames) == NUM_FRAMES
    for frame, image in after.items():
        assert detail(inner(image, frame)) < 0.1 * detail(inner(before[frame], frame))
        # Beside the head all is there, but for another coding.
        rest, shown = before[frame][300:460, 20:620], image[300:460, 20:620]
        assert detail(shown) > 0.5 * detail(rest)


def test_frames_outside_of_the_take_are_black(video: VideoInfo, tmp_path: Path) -> None:
    path = tmp_path / "part.mp4"
    part = HeadRegions("front", CAMERA.size_px, 4, 8, FRAMES, ELLIPSE_PX)
    write_blurred(video, video.time_s, range(4, 8), part, path, lambda: None)
    shown = probe(path)
    assert isinstance(shown, VideoInfo)
    # Players hold a picture until the next one: black from the start, four pictures at their times, black again.
    np.testing.assert_allclose(shown.time_s - shown.time_s[0], np.array([0, 4, 5, 6, 7, 8]) / RATE_HZ, atol=1e-3)
    levels = [image.mean() for image in pictures(path).values()]
    assert max(levels[0], levels[-1]) < 5
    assert min(levels[1:-1]) > 50
    nothing = tmp_path / "nothing.mp4"
    write_blurred(video, video.time_s, range(0), part, nothing, lambda: None)
    assert [image.mean() < 5 for image in pictures(nothing).values()] == [True]


@pytest.mark.slow
def test_overlays_are_drawn_over_blurred_heads(video: VideoInfo, tmp_path: Path) -> None:
    session = CaptureSession((CAMERA,), (video,), {"front": FrameTimes(video.time_s)}, ())
    take = take_of(CAMERA, Timebase(0.0, RATE_HZ, NUM_FRAMES), runner(NUM_FRAMES))
    plain, again, blurred = (tmp_path / name for name in ("plain.mp4", "again.mp4", "blurred.mp4"))
    draw_video(session, take, "front", plain, lambda: None)
    draw_video(session, take, "front", again, lambda: None, None)
    draw_video(session, take, "front", blurred, lambda: None, HEADS)
    assert plain.read_bytes() == again.read_bytes()
    before, after = pictures(plain), pictures(blurred)
    for frame in (0, 5, 11):
        assert detail(inner(after[frame], frame)) < 0.1 * detail(inner(before[frame], frame))
    unknown = HeadRegions("front", CAMERA.size_px, 2, NUM_FRAMES, FRAMES, ELLIPSE_PX)
    draw_video(session, take, "front", blurred, lambda: None, unknown)
    assert detail(pictures(blurred)[0]) < 0.1 * detail(before[0])
