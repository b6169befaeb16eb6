"""Frames that are looked at, and the size that follows from the people in them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.calibration.write import encode
from pipeline.capture.session import CaptureSession, open_session
from pipeline.core.joints import COCO_17, JointSet
from pipeline.detection.bodies import ImageBodies
from pipeline.detection.look import frames_to_look_at, look_at_people
from pipeline.detection.profiles.sizes import CameraLook, CameraSizes, SizeRule, choose_sizes
from tests.pipeline.conftest import ring_camera
from tests.pipeline.media import write_video

SIZE_PX = (96, 80)
RULE = SizeRule(span_px=200.0, max_px=640)


class TallBody:
    """Detector that finds a body of 48 pixels in every image, and keeps the images; all turns alike."""

    def __init__(self) -> None:
        self.grey: list[float] = []
        self.turns_deg: list[float] = []

    def turned(self, turn_deg: float) -> "TallBody":
        self.turns_deg.append(turn_deg)
        return self

    @property
    def joints(self) -> JointSet:
        return COCO_17

    def detect(self, image_rgb: np.ndarray) -> ImageBodies:
        self.grey.append(float(np.median(image_rgb)))
        keypoints_px = np.stack([np.full(17, 30.0), np.linspace(10.0, 58.0, 17)], axis=-1)[None]
        return ImageBodies(keypoints_px, np.full((1, 17), 0.8), np.array([[30.0, 10.0, 30.0, 58.0]]), np.array([0.9]))


def make_session(folder: Path, num_frames: int, keyframe_every: int) -> CaptureSession:
    cameras = [replace(ring_camera(name, angle), size_px=SIZE_PX) for name, angle in (("left", 0.3), ("right", 1.9))]
    (folder / "videos").mkdir()
    for camera in cameras:
        options = {"g": str(keyframe_every), "bf": "2", "sc_threshold": "0"}
        write_video(folder / "videos" / f"{camera.name}.mp4", num_frames, SIZE_PX, options=options)
    (folder / "calibration.json").write_bytes(encode(cameras))
    return open_session(folder / "videos", folder / "calibration.json")


@pytest.mark.parametrize("keyframe_every", [5, 250])
def test_whole_video_is_looked_at(tmp_path: Path, keyframe_every: int) -> None:
    session, detector, steps = make_session(tmp_path, 80, keyframe_every), TallBody(), []
    look = look_at_people(session, "right", detector.turned, RULE, 0.0, 8, True, lambda: steps.append(1))
    assert look == CameraLook(CameraSizes((384,)))  # 400 pixels need more padding
    chosen = frames_to_look_at(session.videos[1], 8)
    np.testing.assert_allclose(detector.grey, [20 + 2 * frame for frame in chosen], atol=3.0)
    assert len(steps) == len(chosen) == 8
    assert chosen[0] <= 5
    assert chosen[-1] >= 70


def test_upright_camera_of_network_of_one_size_is_not_looked_at(tmp_path: Path) -> None:
    session, detector = make_session(tmp_path, 20, 5), TallBody()
    assert look_at_people(session, "right", detector.turned, None, 0.0, 8, False) == CameraLook()
    assert detector.grey == []


def test_all_turns_of_unknown_camera_are_looked_at_once(tmp_path: Path) -> None:
    """The detector finds as much in all turns, so the picture stays as it is."""
    session, detector, steps = make_session(tmp_path, 20, 5), TallBody(), []
    look = look_at_people(session, "right", detector.turned, None, None, 4, False, lambda: steps.append(1))
    assert look == CameraLook(turn_deg=0.0)
    assert len(detector.grey) == 4 * 4
    assert set(detector.turns_deg) == {0.0, 90.0, 180.0, 270.0}
    assert len(steps) == 4


def test_size_is_that_of_upright_picture(tmp_path: Path) -> None:
    """A camera on its side, in whose picture the body lies: 48 pixels of the upright picture's width of 80."""
    session, detector = make_session(tmp_path, 20, 5), TallBody()
    look = look_at_people(session, "right", detector.turned, RULE, 90.0, 8, True)
    assert look.turn_deg == 90.0
    assert look.sizes == choose_sizes([np.array([48.0])] * 4, (80, 96), RULE)


def test_keyframes_are_preferred(tmp_path: Path) -> None:
    session = make_session(tmp_path, 80, 5)
    assert frames_to_look_at(session.videos[0], 4) == [10, 30, 50, 70]
    assert frames_to_look_at(session.videos[0], 100) == list(range(0, 80, 5))
    few = replace(session.videos[0], keyframe_pts=session.videos[0].keyframe_pts[:3])
    assert frames_to_look_at(few, 4) == [10, 30, 50, 70]
    assert len(frames_to_look_at(few, 100)) == 80
