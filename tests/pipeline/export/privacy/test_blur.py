"""Blurred ellipses: what is left of a face is a few means, and all around it stays as it was."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.capture.session import CaptureSession
from pipeline.core.data.cameras import FrameTimes, Timebase
from pipeline.core.data.detections import HeadRegions
from pipeline.export.overlay import draw_video
from pipeline.export.privacy.blur import blur_ellipses, write_blurred
from pipeline.video.decode import decode
from pipeline.video.info import VideoInfo
from pipeline.video.probe import probe
from tests.pipeline.export.test_overlay import CAMERA, NUM_FRAMES, RATE_HZ, runner, take_of
from tests.pipeline.media import write_pictures


def patterned(height: int = 240, width: int = 320, seed: int = 1) -> np.ndarray:
    """Picture with as much detail at every scale as a face has, in any place."""
    noise = np.random.default_rng(seed).normal(size=(height, width, 3))
    octaves = [cv2.GaussianBlur(noise, (0, 0), sigma) * sigma for sigma in (0.7, 1.5, 3.0, 6.0)]
    return np.clip(128 + 60 * np.sum(octaves, axis=0), 0, 255).astype(np.uint8)


def detail(image: np.ndarray) -> float:
    """Mean energy of all that is finer than a sixteenth of a picture's shorter side."""
    coarse = cv2.GaussianBlur(image.astype(float), (0, 0), min(image.shape[:2]) / 16)
    return float(np.mean((image - coarse) ** 2))


@pytest.mark.parametrize("radius_px", [10.0, 24.0, 60.0])
def test_no_detail_of_face_is_left(radius_px: float) -> None:
    image = patterned()
    blurred = blur_ellipses(image, np.array([[160.0, 120.0, radius_px, 1.3 * radius_px]]))
    inner = (
        slice(round(120 - 0.6 * radius_px), round(120 + 0.6 * radius_px)),
        slice(round(160 - 0.6 * radius_px), round(160 + 0.6 * radius_px)),
    )
    assert detail(blurred[inner]) < 0.05 * detail(image[inner])


def test_faces_that_differ_in_detail_alone_become_equal() -> None:
    """Nothing that is finer than a cell decides what is shown: it can't be computed from it."""
    image = patterned()
    ellipse_px = np.array([[160.0, 120.0, 40.0, 40.0]])
    other = image.copy()
    # Each cell of 20 pixels has the same mean of two columns side by side.
    part = other[80:160, 120:200].reshape(80, 40, 2, 3)
    other[80:160, 120:200] = part[:, :, ::-1].reshape(80, 80, 3)
    shown, shown_other = (blur_ellipses(picture, ellipse_px)[95:145, 135:185].astype(int) for picture in (image, other))
    assert np.abs(image[80:160, 120:200].astype(int) - other[80:160, 120:200]).mean() > 10
    assert np.abs(shown - shown_other).max() <= 2


def test_pixels_outside_stay() -> None:
    image = patterned()
    blurred = blur_ellipses(image, np.array([[100.0, 60.0, 20.0, 30.0]]))
    rows, columns = np.mgrid[:240, :320]
    is_outside = ((columns - 100) / 20) ** 2 + ((rows - 60) / 30) ** 2 > 1
    np.testing.assert_array_equal(blurred[is_outside], image[is_outside])
    assert (blurred[~is_outside] != image[~is_outside]).any(axis=-1).mean() > 0.9


def test_ellipses_at_edge_and_beyond_it() -> None:
    image = patterned()
    far = np.array([[-500.0, 60.0, 20.0, 30.0], [160.0, 900.0, 20.0, 30.0]])
    np.testing.assert_array_equal(blur_ellipses(image, far), image)
    np.testing.assert_array_equal(blur_ellipses(image, np.empty((0, 4))), image)
    at_edge = blur_ellipses(image, np.array([[0.0, 120.0, 30.0, 30.0]]))
    assert detail(at_edge[105:135, :15]) < 0.02 * detail(image[105:135, :15])
    whole = blur_ellipses(image, np.array([[160.0, 120.0, 320.0, 240.0]]))
    assert detail(whole) < 0.02 * detail(image)


def test_tiny_head_is_blurred_too() -> None:
    image = np.zeros((60, 60, 3), np.uint8)
    image[::2] = 255
    blurred = blur_ellipses(image, np.array([[30.0, 30.0, 4.0, 4.0]]))
    assert np.ptp(blurred[29:32, 29:32].astype(int)) < 160


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


def test_heads_are_gone_from_encoded_video(video: VideoInfo, tmp_path: Path) -> None:
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


def test_frames_outside_of_take_are_black(video: VideoInfo, tmp_path: Path) -> None:
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
