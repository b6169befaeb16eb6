from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest

from pipeline.calibration.write import encode
from pipeline.capture.session import CaptureSession, open_session
from pipeline.core.data.detections import Detections
from pipeline.core.joints import BODY_FEET, COCO_17, JointSet
from pipeline.detection.bodies import ImageBodies, boxes_around, concatenate
from pipeline.detection.chunk import detect_chunk
from pipeline.detection.topdown.blazepose import body_region
from pipeline.detection.topdown.topdown_detector import TopDown
from pipeline.video.timeline import span_s
from tests.pipeline.conftest import ring_camera
from tests.pipeline.detection.topdown.people import landmarks_px, pose_of, standing_px
from tests.pipeline.media import write_video

NUM_FRAMES, SIZE_PX = 24, (96, 80)


@dataclass
class BrightBody:
    """Detector of a body whose place depends on the picture; it counts its pictures."""

    joints: JointSet = COCO_17
    num_images: int = 0

    def detect(self, image_rgb: np.ndarray) -> ImageBodies:
        self.num_images += 1
        keypoints_px = standing_px()[None] + image_rgb.mean() / 50
        score = np.full((1, 17), 0.6)
        return ImageBodies(keypoints_px, score, boxes_around(keypoints_px), np.full(1, 0.8))


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> CaptureSession:
    folder = tmp_path_factory.mktemp("session")
    cameras = [replace(ring_camera(name, angle), size_px=SIZE_PX) for name, angle in (("left", 0.3), ("right", 1.9))]
    (folder / "videos").mkdir()
    for camera in cameras:
        write_video(folder / "videos" / f"{camera.name}.mp4", NUM_FRAMES, SIZE_PX)
    (folder / "calibration.json").write_bytes(encode(cameras))
    return open_session(folder / "videos", folder / "calibration.json")


def top_down(body: BrightBody, refines_body: bool = True) -> TopDown:
    region = body_region(standing_px(), np.full(17, 0.6))
    assert region is not None
    outputs = pose_of(landmarks_px(), region)
    return TopDown(body, lambda _: outputs, None, refines_body, BODY_FEET)


def detect_in(session: CaptureSession, detector: TopDown, borders: list[int], follow_s: float) -> Detections:
    """Detections of ranges of output frames, joined."""
    steps: list[None] = []
    chunks = [
        detect_chunk(
            session, "left", span_s(session.timebase, *frames), detector, lambda: steps.append(None), True, follow_s
        )
        for frames in pairwise(borders)
    ]
    assert len(steps) == NUM_FRAMES
    return concatenate(chunks, ["left"], len(BODY_FEET.names))["left"]


def test_bodies_are_followed_between_detections_whatever_cut(session: CaptureSession) -> None:
    follow_s = 3.0 / session.timebase.frame_rate_hz
    body = BrightBody()
    whole = detect_in(session, top_down(body), [0, NUM_FRAMES], follow_s)
    assert body.num_images < NUM_FRAMES / 2
    np.testing.assert_array_equal(whole.frame, np.arange(NUM_FRAMES))
    cut = detect_in(session, top_down(BrightBody()), [0, 2, 5, 6, 17, 23, NUM_FRAMES], follow_s)
    for name in ("frame", "keypoints_px", "score", "box_px", "damaged", "colour"):
        np.testing.assert_array_equal(getattr(cut, name), getattr(whole, name))
    np.testing.assert_array_equal(cut.changes.change, whole.changes.change)


@pytest.mark.parametrize("refines_body", [True, False])
def test_without_follow_every_frame_is_detected(session: CaptureSession, refines_body: bool) -> None:
    body = BrightBody()
    detect_in(session, top_down(body, refines_body), [0, NUM_FRAMES], 0.0)
    assert body.num_images == NUM_FRAMES


def test_range_without_frames_has_no_bodies(session: CaptureSession) -> None:
    detections = detect_chunk(session, "left", (-2.0, -1.0), top_down(BrightBody()), follow_s=0.04)
    assert detections.keypoints_px.shape == (0, len(BODY_FEET.names), 2)
