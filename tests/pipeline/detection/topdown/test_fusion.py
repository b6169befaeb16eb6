import numpy as np
import pytest

from pipeline.core.joints import COCO_17
from pipeline.detection.topdown.blazepose import LANDMARK
from pipeline.detection.topdown.fusion import (
    COMMON_OFFSETS,
    LANDMARK_OFFSETS,
    NOT_SHARED,
    SHARED_JOINTS,
    SHARED_LANDMARKS,
    common_marks_px,
    fuse,
    landmark_offsets_px,
)
from pipeline.detection.topdown.regions import Region
from tests.pipeline.detection.topdown.people import CENTER_PX, decoded, landmarks_px, standing_px

REGION = Region((float(CENTER_PX[0]), float(CENTER_PX[1])), 480.0)
SURE = np.full(17, 0.9)
ELBOW, HIP, KNEE = COCO_17.indices(("left_elbow", "left_hip", "left_knee"))


def mapped_landmarks_px() -> np.ndarray:
    """Landmarks of a body whose joints are those of ``standing_px``: where the joint maps put them."""
    points_px = landmarks_px()
    points_px[list(SHARED_LANDMARKS)] += landmark_offsets_px(standing_px())
    return points_px


def test_offsets_lie_along_trunk_and_shoulders() -> None:
    offsets_px = dict(zip(SHARED_JOINTS, landmark_offsets_px(standing_px()), strict=True))
    hip = LANDMARK_OFFSETS["hip"]
    # The trunk is 120 pixels long and upright, the shoulders are 60 pixels wide with the left one at the right.
    np.testing.assert_allclose(offsets_px["left_hip"], (60 * hip.outwards, -120 * hip.up))
    np.testing.assert_allclose(offsets_px["right_hip"], (-60 * hip.outwards, -120 * hip.up))
    assert offsets_px["left_hip"][1] > 0
    np.testing.assert_array_equal(offsets_px["nose"], (0, 0))


def test_offsets_are_unknown_where_trunk_is_missing() -> None:
    joints_px = standing_px()
    joints_px[HIP] = np.nan
    offsets_px = dict(zip(SHARED_JOINTS, landmark_offsets_px(joints_px), strict=True))
    assert np.isnan(offsets_px["left_shoulder"]).all()
    np.testing.assert_array_equal(offsets_px["left_knee"], (0, 0))


def test_common_marks_move_shoulders_down_trunk_and_nothing_else() -> None:
    moved_px = common_marks_px(standing_px()) - standing_px()
    shoulders = COCO_17.indices(("left_shoulder", "right_shoulder"))
    np.testing.assert_allclose(moved_px[shoulders], [(0, -120 * COMMON_OFFSETS["shoulder"].up)] * 2)
    assert (moved_px[shoulders, 1] > 0).all()
    assert not np.delete(moved_px, shoulders, axis=0).any()


def test_body_without_hip_keeps_its_shoulders() -> None:
    joints_px = standing_px()
    joints_px[HIP] = np.nan
    np.testing.assert_array_equal(common_marks_px(joints_px), joints_px)


def test_body_without_crop_is_at_common_marks_too() -> None:
    fused_px, score = fuse(standing_px(), SURE, None)
    np.testing.assert_array_equal(fused_px, common_marks_px(standing_px()))
    np.testing.assert_array_equal(score, SURE)


def test_networks_that_agree_change_nothing() -> None:
    fused_px, _ = fuse(standing_px(), SURE, decoded(mapped_landmarks_px(), REGION))
    np.testing.assert_allclose(fused_px, common_marks_px(standing_px()), atol=0.3)


def test_weights_are_squares_of_score_and_peak() -> None:
    points_px = mapped_landmarks_px()
    points_px[LANDMARK["left_knee"]] += (7.5, 0.0)  # one cell: the peak stays on the same kind of place
    score = SURE.copy()
    score[KNEE] = 0.45
    pose = decoded(points_px, REGION)
    expected_px = np.full((33, 2), np.nan)
    expected_px[LANDMARK["left_knee"]] = standing_px()[KNEE]
    read_px, peak = (read[LANDMARK["left_knee"]] for read in pose.near(expected_px))
    share = peak**2 / (peak**2 + 0.45**2)
    fused_px, _ = fuse(standing_px(), score, pose)
    np.testing.assert_allclose(fused_px[KNEE], standing_px()[KNEE] + share * (read_px - standing_px()[KNEE]))
    assert fused_px[KNEE, 0] - standing_px()[KNEE, 0] == pytest.approx(share * 7.5, abs=0.5)


def test_another_persons_limb_far_away_is_not_taken() -> None:
    points_px = mapped_landmarks_px()
    points_px[LANDMARK["left_elbow"]] += (60.0, 0.0)
    fused_px, _ = fuse(standing_px(), SURE, decoded(points_px, REGION))
    np.testing.assert_array_equal(fused_px[ELBOW], standing_px()[ELBOW])


def test_unsure_heatmap_changes_nothing() -> None:
    points_px = mapped_landmarks_px()
    points_px[LANDMARK["left_elbow"]] += (5.0, 0.0)
    fused_px, _ = fuse(standing_px(), SURE, decoded(points_px, REGION, {"left_elbow": 0.45}))
    np.testing.assert_array_equal(fused_px[ELBOW], standing_px()[ELBOW])


def test_ears_and_missing_joints_stay_as_they_are() -> None:
    joints_px, score = standing_px(), SURE.copy()
    joints_px[KNEE], score[KNEE] = np.nan, 0
    fused_px, _ = fuse(joints_px, score, decoded(landmarks_px() + np.array((3.0, 0.0)), REGION))
    assert np.isnan(fused_px[KNEE]).all()
    ears = COCO_17.indices(tuple(sorted(NOT_SHARED)))
    np.testing.assert_array_equal(fused_px[ears], standing_px()[ears])
    assert (fused_px[ELBOW] != standing_px()[ELBOW]).any()


def test_score_is_that_of_surer_network() -> None:
    score = np.where(np.arange(17) == KNEE, 0.3, 0.85)
    pose = decoded(mapped_landmarks_px(), REGION, {"left_elbow": 0.45})
    _, fused = fuse(standing_px(), score, pose)
    assert 0.5 < fused[KNEE] <= 0.8
    np.testing.assert_array_equal(np.delete(fused, KNEE), np.delete(score, KNEE))


def test_missing_joint_keeps_score_0() -> None:
    joints_px, score = standing_px(), SURE.copy()
    joints_px[KNEE], score[KNEE] = np.nan, 0
    _, fused = fuse(joints_px, score, decoded(landmarks_px(), REGION))
    assert fused[KNEE] == 0
