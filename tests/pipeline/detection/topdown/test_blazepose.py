import numpy as np
import pytest

from pipeline.core.joints import COCO_17
from pipeline.detection.topdown.blazepose import LANDMARK, body_region, decode_pose
from pipeline.detection.topdown.regions import Region
from tests.pipeline.detection.topdown.people import CENTER_PX, landmarks_px, pose_of, standing_px

SURE = np.full(17, 0.9)
TURNED = Region((310.0, 240.0), 480.0, 0.4)


def test_region_of_standing_body_is_centred_on_hips_and_upright() -> None:
    region = body_region(standing_px(), SURE)
    assert region is not None
    np.testing.assert_allclose(region.center_px, CENTER_PX)
    # The left ear is the farthest joint.
    assert region.side_px == pytest.approx(2.5 * 1.1 * np.hypot(5, 165))
    assert region.angle_rad == pytest.approx(0.0)


@pytest.mark.parametrize("angle_rad", [0.7, -2.0, 3.0])
def test_region_turns_with_trunk(angle_rad: float) -> None:
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    turned_px = (standing_px() - CENTER_PX) @ np.array([[cos, sin], [-sin, cos]]) + CENTER_PX
    region = body_region(turned_px, SURE)
    assert region is not None
    assert region.angle_rad == pytest.approx(angle_rad)
    np.testing.assert_allclose(region.crop_from_image(turned_px[5:7].mean(0), 256)[0], 127.5, atol=1e-6)


def test_small_bodies_and_bodies_of_few_joints_have_no_region() -> None:
    assert body_region(CENTER_PX + 0.1 * (standing_px() - CENTER_PX), SURE) is None
    few = np.where(np.arange(17) < 4, 0.9, 0.1)
    assert body_region(standing_px(), few) is None


def test_body_without_hips_is_centred_on_its_box() -> None:
    joints_px, score = standing_px(), SURE.copy()
    joints_px[COCO_17.indices(("left_hip", "right_hip"))] = np.nan
    score[COCO_17.indices(("left_hip", "right_hip"))] = 0
    region = body_region(joints_px, score)
    assert region is not None
    np.testing.assert_allclose(region.center_px, CENTER_PX + np.array((0.0, -2.5)))
    assert region.angle_rad == 0


def test_landmarks_are_decoded_to_pixels_of_image() -> None:
    pose = decode_pose(pose_of(landmarks_px(), TURNED), TURNED)
    np.testing.assert_allclose(pose.regressed_px, landmarks_px(), atol=1e-3)
    refined_px, peak = pose.refined()
    # A cell of the heatmap is 7.5 pixels of the image wide.
    np.testing.assert_allclose(refined_px, landmarks_px(), atol=0.3)
    assert (peak > 0.6).all()


def test_heat_corrects_landmark_unless_unsure() -> None:
    wrong_px = landmarks_px() + np.array((9.0, -6.0))
    outputs = pose_of(landmarks_px(), TURNED, {"left_heel": 0.4}, wrong_px)
    refined_px, peak = decode_pose(outputs, TURNED).refined()
    heel, toe = LANDMARK["left_heel"], LANDMARK["left_foot_index"]
    assert np.linalg.norm(refined_px[toe] - landmarks_px()[toe]) < 1
    np.testing.assert_allclose(refined_px[heel], wrong_px[heel], atol=1e-3)
    assert peak[heel] < 0.5
