"""Joints of a body from BlazePose's landmarks alone."""

import numpy as np
import pytest

from pipeline.association.redetection.crops import read_body
from pipeline.core.joints import BODY_FEET, COCO_17
from pipeline.detection.topdown.blazepose import body_region
from pipeline.detection.topdown.fusion import LANDMARK_OFFSETS
from pipeline.detection.topdown.regions import Region
from tests.pipeline.detection.topdown.people import decoded, landmarks_px, standing_px

_REGION = body_region(standing_px(), np.ones(17))
assert _REGION is not None
REGION: Region = _REGION


def test_joints_without_offset_are_landmarks() -> None:
    keypoints_px, score = read_body(decoded(landmarks_px(), REGION), COCO_17, at_common_marks=True)
    limbs = COCO_17.indices(("left_elbow", "right_wrist", "left_knee", "right_ankle", "nose"))
    np.testing.assert_allclose(keypoints_px[limbs], standing_px()[limbs], atol=2.0)
    assert (score[limbs] > 0.5).all()


def test_ears_are_defined_otherwise_and_left_out() -> None:
    keypoints_px, score = read_body(decoded(landmarks_px(), REGION), COCO_17, at_common_marks=False)
    ears = COCO_17.indices(("left_ear", "right_ear"))
    assert np.isnan(keypoints_px[ears]).all()
    assert (score[ears] == 0).all()


def test_hips_and_shoulders_move_to_marks_of_other_joints() -> None:
    pose = decoded(landmarks_px(), REGION)
    hip, shoulder = COCO_17.indices(("left_hip", "left_shoulder"))
    detector_px, _ = read_body(pose, COCO_17, at_common_marks=False)
    trunk_px = 120.0
    assert detector_px[hip, 1] - standing_px()[hip, 1] == pytest.approx(LANDMARK_OFFSETS["hip"].up * trunk_px, abs=2.0)
    common_px, _ = read_body(pose, COCO_17, at_common_marks=True)
    assert common_px[hip, 1] == detector_px[hip, 1]
    assert common_px[shoulder, 1] != detector_px[shoulder, 1]


def test_unsure_landmarks_are_unknown_and_feet_are_read() -> None:
    pose = decoded(landmarks_px(), REGION, {"left_wrist": 0.4, "right_heel": 0.3})
    keypoints_px, score = read_body(pose, BODY_FEET, at_common_marks=True)
    unsure = BODY_FEET.indices(("left_wrist", "right_heel"))
    assert np.isnan(keypoints_px[unsure]).all()
    assert (score[unsure] == 0).all()
    feet = BODY_FEET.indices(("left_heel", "left_big_toe", "right_big_toe"))
    assert (score[feet] > 0.5).all()
