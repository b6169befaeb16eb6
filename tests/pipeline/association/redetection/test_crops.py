"""Detection of expected bodies in the frames of a video."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest

from pipeline.association.redetection.crops import detect_expected
from pipeline.association.redetection.expect import ExpectedBodies
from pipeline.calibration.write import encode
from pipeline.capture.session import CaptureSession, open_session
from pipeline.core.joints import BODY_FEET, COCO_17
from pipeline.detection.topdown.blazepose import body_region
from tests.pipeline.conftest import ring_camera
from tests.pipeline.detection.topdown.people import landmarks_px, pose_of, standing_px
from tests.pipeline.media import write_video

SIZE_PX = (640, 480)


@pytest.fixture
def session(tmp_path: Path) -> CaptureSession:
    """Session of one camera with a video of ten frames, and another one."""
    cameras = [ring_camera(name, angle) for name, angle in (("left", 0.0), ("right", 1.5))]
    (tmp_path / "calibration.json").write_bytes(encode(cameras))
    (tmp_path / "videos").mkdir()
    for camera in cameras:
        write_video(tmp_path / "videos" / f"{camera.name}.mp4", 10, camera.size_px)
    return open_session(tmp_path / "videos", tmp_path / "calibration.json")


class CropReader:
    """Network that sees somebody who stands in every crop of the same body."""

    def __init__(self, presence: float = 1.0) -> None:
        self.presence, self.num_crops = presence, 0

    def __call__(self, crop: np.ndarray) -> dict[str, np.ndarray]:
        self.num_crops += 1
        region = body_region(standing_px(), np.ones(17))
        assert region is not None
        assert crop.shape == (1, 3, 256, 256)
        return pose_of(landmarks_px(), region) | {"presence": np.full((1, 1), self.presence, np.float32)}


def expected(frames: list[int], scale: float = 1.0) -> ExpectedBodies:
    num = len(frames)
    bodies_px = np.tile(standing_px() * scale, (num, 1, 1))
    return ExpectedBodies("left", np.array(frames, np.int64), bodies_px, np.full(num, 200.0), np.ones(num, bool))


def test_bodies_are_read_where_they_are_expected(session: CaptureSession) -> None:
    shares: list[float] = []
    found = detect_expected(session, expected([2, 5, 5]), CropReader, BODY_FEET, True, 0.0, shares.append)
    assert found.frame.tolist() == [2, 5, 5]
    assert (found.box_px[:, 0] < found.box_px[:, 2]).all()
    assert found.keypoints_px.shape == (3, len(BODY_FEET.names), 2)
    knees = BODY_FEET.indices(("left_knee", "right_knee"))
    np.testing.assert_allclose(
        found.keypoints_px[0, knees], standing_px()[COCO_17.indices(("left_knee", "right_knee"))], atol=2.0
    )
    assert shares == pytest.approx([1 / 3, 1.0])


def test_others_are_painted_out_where_body_is_not(session: CaptureSession) -> None:
    """A second person stands a shoulder's width to the right, a third one beside the picture: one is wanted."""
    crops: list[np.ndarray] = []

    def reader(crop: np.ndarray) -> dict[str, np.ndarray]:
        crops.append(crop.copy())
        return CropReader()(crop)

    alone = expected([4])
    detect_expected(session, alone, lambda: reader, COCO_17, True)
    shift_px = np.array([np.zeros(2), [90.0, 0.0], [900.0, 0.0]])[:, None]
    together = replace(expected([4, 4, 4]), keypoints_px=alone.keypoints_px + shift_px)
    found = detect_expected(session, replace(together, is_wanted=np.arange(3) == 0), lambda: reader, COCO_17, True)
    assert found.frame.tolist() == [4]
    before, painted = crops
    grey = (painted == np.float32(0.43)).all((0, 1))
    np.testing.assert_array_equal(painted[:, :, ~grey], before[:, :, ~grey])
    region = body_region(alone.keypoints_px[0], np.ones(17))
    assert region is not None
    own, other = (
        np.rint(region.crop_from_image(bodies_px[5:], 256)).astype(int).clip(0, 255)
        for bodies_px in together.keypoints_px[:2]
    )
    assert not grey[own[:, 1], own[:, 0]].any()
    assert grey[other[:, 1], other[:, 0]].mean() > 0.5


def test_crop_without_body_gives_none(session: CaptureSession) -> None:
    found = detect_expected(session, expected([2]), partial(CropReader, presence=0.2), COCO_17, True)
    assert len(found.frame) == 0


def test_body_too_small_to_read_is_left_out(session: CaptureSession) -> None:
    reader = CropReader()
    assert len(detect_expected(session, expected([3], 0.05), lambda: reader, COCO_17, True).frame) == 0
    assert reader.num_crops == 0


def load_nothing() -> NoReturn:
    """Fail where a network is loaded."""
    raise AssertionError("A network is loaded where nobody is expected.")


def test_nothing_is_loaded_or_decoded_where_nobody_is_expected(session: CaptureSession) -> None:
    session.videos[0].path.unlink()
    assert len(detect_expected(session, expected([]), load_nothing, COCO_17, True).frame) == 0
