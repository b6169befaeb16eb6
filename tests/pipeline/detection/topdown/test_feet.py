import numpy as np

from pipeline.core.joints import COCO_17
from pipeline.detection.topdown.blazepose import LANDMARK
from pipeline.detection.topdown.regions import Region
from pipeline.detection.topdown.topdown_detector import FOOT_JOINTS, read_feet
from tests.pipeline.detection.topdown.people import CENTER_PX, decoded, landmarks_px, standing_px

REGION = Region((float(CENTER_PX[0]), float(CENTER_PX[1])), 480.0)
ANKLES_PX = standing_px()[COCO_17.indices(("left_ankle", "right_ankle"))]
SIZE_PX = 340.0


def test_heels_and_toes_come_from_their_own_landmarks() -> None:
    points_px, score = read_feet(decoded(landmarks_px(), REGION), ANKLES_PX, SIZE_PX)
    assert FOOT_JOINTS == ("left_heel", "right_heel", "left_big_toe", "right_big_toe")
    names = ("left_heel", "right_heel", "left_foot_index", "right_foot_index")
    np.testing.assert_allclose(points_px, landmarks_px()[[LANDMARK[name] for name in names]], atol=0.3)
    assert ((score > 0.5) & (score <= 0.8)).all()


def test_foot_whose_ankle_is_elsewhere_is_left_out() -> None:
    ankles_px = ANKLES_PX.copy()
    ankles_px[1] += (0.07 * SIZE_PX, 0.0)
    points_px, score = read_feet(decoded(landmarks_px(), REGION), ankles_px, SIZE_PX)
    assert np.isfinite(points_px[[0, 2]]).all()
    assert np.isnan(points_px[[1, 3]]).all()
    assert score[1] == score[3] == 0


def test_foot_without_ankle_is_left_out() -> None:
    points_px, _ = read_feet(decoded(landmarks_px(), REGION), ANKLES_PX * np.array([[np.nan], [1.0]]), SIZE_PX)
    np.testing.assert_array_equal(np.isnan(points_px[:, 0]), [True, False, True, False])


def test_unsure_toe_is_left_out_alone() -> None:
    pose = decoded(landmarks_px(), REGION, {"right_foot_index": 0.4})
    points_px, score = read_feet(pose, ANKLES_PX, SIZE_PX)
    np.testing.assert_array_equal(np.isnan(points_px[:, 0]), [False, False, False, True])
    assert score[3] == 0
