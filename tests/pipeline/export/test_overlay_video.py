"""Overlay videos: skeletons are where the lens shows them at the time of each frame."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.capture.session import CaptureSession
from pipeline.core.data.animation import Animation
from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.people import Track3D
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.joints import COCO_17
from pipeline.export.overlay_video import draw_video, overlay_names
from pipeline.geometry.camera import project
from pipeline.video.decode import decode
from pipeline.video.info import VideoInfo
from pipeline.video.probe import probe
from tests.pipeline.export.test_overlay import CAMERA
from tests.pipeline.media import write_pictures
from tests.pipeline.motion.skeleton.synthetic_tracks import track_of

RATE_HZ, OFFSET_S, NUM_FRAMES = 25.0, 0.313, 12
LARGE = replace(CAMERA, size_px=(1600, 1200), matrix=np.diag([2.5, 2.5, 1.0]) @ CAMERA.matrix)
SPEED_M_S = 3.0


def place_m(time_s: float) -> np.ndarray:
    """Place of the only known joint of somebody who runs."""
    return np.array([SPEED_M_S * (time_s - 0.5), 0.3, 1.1])


def runner(num_frames: int = 40) -> Track3D:
    xyz_m = np.full((num_frames, len(COCO_17.names), 3), np.nan)
    xyz_m[:, COCO_17.index("left_wrist")] = [place_m(frame / RATE_HZ) for frame in range(num_frames)]
    return track_of(xyz_m, 3)


def take_of(camera: Camera, timebase: Timebase, track: Track3D) -> Reconstruction:
    return Reconstruction((camera,), COCO_17, timebase, (track,), (), Animation((track,), (), None))


def session_of(camera: Camera, folder: Path) -> CaptureSession:
    grey = np.full((camera.size_px[1], camera.size_px[0], 3), 90, np.uint8)
    video = probe(write_pictures(folder / "front.mp4", [grey] * NUM_FRAMES))
    assert isinstance(video, VideoInfo)
    return CaptureSession((camera,), (video,), {camera.name: FrameTimes(OFFSET_S + video.time_s)}, ())


def drawn_column(image: np.ndarray, row: float) -> float:
    """Column of the middle of what was drawn in some rows."""
    rows = image[round(row) - 3 : round(row) + 4].astype(int)
    return float(np.argwhere((np.abs(rows - 90) > 50).any(-1))[:, 1].mean())


def test_people_are_where_they_were_at_the_time_of_each_frame(tmp_path: Path) -> None:
    session = session_of(LARGE, tmp_path)
    frames: list[None] = []
    path = tmp_path / "overlay.mp4"
    take = take_of(LARGE, Timebase(0.0, RATE_HZ, 40), runner())
    assert draw_video(session, take, "front", path, lambda: frames.append(None))
    overlay = probe(path)
    assert isinstance(overlay, VideoInfo)
    assert (overlay.browser_media_type, overlay.size_px, len(frames)) == ("video/mp4", (1280, 960), NUM_FRAMES)
    np.testing.assert_allclose(overlay.time_s, session.videos[0].time_s, atol=1e-4)
    num_compared = 0
    for number, image in decode(overlay, 0, NUM_FRAMES):
        # The outer edges of both pictures are the same: pixel -0.5.
        column, row = (project(LARGE, place_m(OFFSET_S + number / RATE_HZ)) + 0.5) * 0.8 - 0.5
        assert drawn_column(image, row) == pytest.approx(column, abs=1.0)
        num_compared += 1
    assert num_compared == NUM_FRAMES


def test_the_video_is_of_the_take_alone(tmp_path: Path) -> None:
    session = session_of(CAMERA, tmp_path)
    # Frames 3 to 7 of the camera were taken within half an output frame of these five.
    cut = take_of(CAMERA, Timebase(OFFSET_S + 3 / RATE_HZ, RATE_HZ, 5), runner(5))
    assert draw_video(session, cut, "front", tmp_path / "cut.mp4", lambda: None)
    overlay = probe(tmp_path / "cut.mp4")
    assert isinstance(overlay, VideoInfo)
    np.testing.assert_allclose(overlay.time_s, np.arange(5) / RATE_HZ, atol=1e-4)
    later = take_of(CAMERA, Timebase(60.0, RATE_HZ, 5), runner(5))
    assert not draw_video(session, later, "front", tmp_path / "later.mp4", lambda: None)
    assert not (tmp_path / "later.mp4").exists()


def test_names_are_safe_and_different() -> None:
    hostile = ["a", "A", "../etc", "a%2f", "кам", "", "x" * 300, 'b"<script>']
    names = overlay_names(hostile)
    assert names[:4] == ("overlay-a.mp4", "overlay-A-2.mp4", "overlay-etc.mp4", "overlay-a-2f.mp4")
    assert names[4:6] == ("overlay-camera.mp4", "overlay-camera-2.mp4")
    assert len(names[6]) < 80
    assert len({name.lower() for name in names}) == len(hostile)
    assert all(one.isalnum() or one in "-_." for name in names for one in name)


def test_an_interrupted_work_ends_at_once(tmp_path: Path) -> None:
    session = session_of(CAMERA, tmp_path)

    def stop() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        draw_video(session, take_of(CAMERA, Timebase(0.0, RATE_HZ, 40), runner()), "front", tmp_path / "a.mp4", stop)
