from dataclasses import dataclass

import numpy as np
import pytest

from pipeline.core.joints import BODY_25, BODY_FEET, COCO_17, WHOLE_BODY, JointSet, finger_joints
from pipeline.detection.bodies import BodyDetector, ImageBodies
from pipeline.detection.network import Network, one_by_one
from pipeline.detection.topdown.blazepose import body_region
from pipeline.detection.topdown.fusion import common_marks_px
from pipeline.detection.topdown.topdown_detector import TopDown
from tests.pipeline.detection.topdown.people import landmarks_px, pose_of, standing_px

IMAGE = np.zeros((480, 640, 3), np.uint8)


@dataclass(frozen=True)
class FixedBodies:
    """Detector that finds the same bodies in every image."""

    keypoints_px: np.ndarray
    joints: JointSet = COCO_17

    def detect(self, image_rgb: np.ndarray) -> ImageBodies:
        del image_rgb
        box_px = np.concatenate([self.keypoints_px.min(1), self.keypoints_px.max(1)], axis=1)
        n = len(self.keypoints_px)
        return ImageBodies(self.keypoints_px, np.full((n, len(self.joints.names)), 0.6), box_px, np.full(n, 0.8))


def network_of(points_px: np.ndarray) -> Network:
    """Fake BlazePose for the crop of the standing body."""
    region = body_region(standing_px(), np.full(17, 0.6))
    assert region is not None
    outputs = pose_of(points_px, region)
    return one_by_one(lambda _: outputs)


def hand_network(_: np.ndarray) -> dict[str, np.ndarray]:
    """Fake hand network: a hand in the middle of every crop, with its wrist at a third of the height below."""
    raw = np.zeros((21, 3), np.float32)
    raw[:, 0] = 111.5
    raw[0, 1] = 111.5 + 224 * (1.2 / (2 * 1.89))
    raw[1:, 1] = np.linspace(120, 20, 20)
    ones = np.ones((1, 1), np.float32)
    return {"landmarks": raw.reshape(1, 63), "presence": ones, "handedness": ones}


def one_body() -> FixedBodies:
    return FixedBodies(standing_px()[None])


def test_detector_is_detector_of_bodies() -> None:
    detector = TopDown(one_body(), network_of(landmarks_px()), None, True, BODY_FEET)
    assert isinstance(detector, BodyDetector)
    assert isinstance(one_body(), BodyDetector)


def test_other_joints_than_those_of_coco_are_refused() -> None:
    with pytest.raises(ValueError, match="COCO-17"):
        TopDown(FixedBodies(np.zeros((1, 25, 2)), BODY_25), network_of(landmarks_px()), None, True, BODY_FEET)


@pytest.mark.parametrize("joints", [COCO_17, BODY_FEET, WHOLE_BODY])
def test_bodies_have_joints_that_are_asked_for(joints: JointSet) -> None:
    hand = one_by_one(hand_network) if joints is WHOLE_BODY else None
    bodies = TopDown(one_body(), network_of(landmarks_px()), hand, True, joints).detect(IMAGE)
    assert bodies.score.shape == (1, len(joints.names))
    np.testing.assert_array_equal(bodies.score > 0, np.isfinite(bodies.keypoints_px).all(-1))
    assert (bodies.score[0] > 0).all()
    np.testing.assert_array_equal(bodies.center_score, [0.8])


def test_without_refinement_body_stays_and_feet_are_added() -> None:
    bodies = TopDown(one_body(), network_of(landmarks_px() + 2.0), None, False, BODY_FEET).detect(IMAGE)
    np.testing.assert_array_equal(bodies.keypoints_px[0, :17], standing_px())
    assert np.isfinite(bodies.keypoints_px[0, 17:]).all()
    refined = TopDown(one_body(), network_of(landmarks_px() + 2.0), None, True, BODY_FEET).detect(IMAGE)
    assert (np.linalg.norm(refined.keypoints_px[0, :17] - standing_px(), axis=-1) > 0.5).sum() > 10


def test_fingers_hang_on_their_own_wrist() -> None:
    bodies = TopDown(one_body(), network_of(landmarks_px()), one_by_one(hand_network), True, WHOLE_BODY).detect(IMAGE)
    for side, wrist in zip(
        ("left", "right"), standing_px()[COCO_17.indices(("left_wrist", "right_wrist"))], strict=True
    ):
        fingers_px = bodies.keypoints_px[0, WHOLE_BODY.indices(finger_joints(side))]
        distance_px = np.linalg.norm(fingers_px - wrist, axis=-1)
        assert (distance_px < 120).all()
        assert (np.diff(fingers_px[:, 1]) > 0).all()  # the hands point down, from the thumb's base to the last tip


def test_small_bodies_keep_joints_of_detector() -> None:
    small_px = 100 + 0.1 * (standing_px() - standing_px().mean(0))
    bodies = TopDown(FixedBodies(small_px[None]), network_of(landmarks_px()), None, True, BODY_FEET).detect(IMAGE)
    np.testing.assert_array_equal(bodies.keypoints_px[0, :17], common_marks_px(small_px))
    assert np.isnan(bodies.keypoints_px[0, 17:]).all()
    assert (bodies.score[0, 17:] == 0).all()


def test_image_without_bodies() -> None:
    detector = TopDown(
        FixedBodies(np.zeros((0, 17, 2))), network_of(landmarks_px()), one_by_one(hand_network), True, WHOLE_BODY
    )
    assert detector.detect(IMAGE).keypoints_px.shape == (0, 61, 2)


def test_body_without_trunk_is_upright_in_turned_picture() -> None:
    score = np.full(17, 0.6)
    score[COCO_17.indices(("left_hip", "right_hip"))] = 0.0
    regions = [body_region(standing_px(), score, turn_deg) for turn_deg in (0.0, 90.0)]
    assert [region and region.angle_rad for region in regions] == [0.0, pytest.approx(np.pi / 2)]
    trunk = body_region(standing_px(), np.full(17, 0.6), 90.0)
    assert trunk is not None
    assert abs(trunk.angle_rad) < 0.2  # the trunk says more
