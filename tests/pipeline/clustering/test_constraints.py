import numpy as np

from pipeline.clustering.bone_lengths import LimbLengths, measure_lengths, unknown_lengths
from pipeline.clustering.constraints import is_connected, length_error, membership
from pipeline.clustering.skeleton import skeleton_of
from pipeline.joints import COCO_17


def test_membership_is_the_share_of_views_that_agree() -> None:
    parents = np.array([[0, 1, 2, -1], [3, -1, -1, 5]])
    points = np.array([[0, 1, -1, -1], [0, 7, -1, -1], [-1, -1, -1, 5], [-1, 1, -1, -1]])
    score = membership(parents, points)
    np.testing.assert_array_equal(score, [[1.0, 0.5, np.nan, 1.0], [0.0, 0.0, 1.0, np.nan]])
    np.testing.assert_array_equal(is_connected(score, 0.6)[0], [True, False, True, True])


def test_a_length_fits_the_nearest_of_the_known() -> None:
    lengths = LimbLengths(np.array([[np.nan, np.nan], [0.30, 0.40], [np.nan, np.nan]]), np.array([0.0, 0.5, 0.5]))
    parents_m = np.zeros((1, 3))
    points_m = np.array([[0.33, 0.0, 0.0], [0.0, 0.38, 0.0], [0.0, 0.0, 0.49], [0.6, 0.0, 0.0]])
    error = length_error(parents_m, points_m, np.array([1, 1, 1, 1]), lengths)
    np.testing.assert_allclose(error, [[0.1, 0.05, 0.225, np.inf]])
    unknown = length_error(parents_m, points_m, np.array([2, 2, 2, 2]), lengths)
    np.testing.assert_array_equal(unknown, [[0.0, 0.0, 0.0, np.inf]])


def test_lengths_are_a_persons_medians() -> None:
    skeleton = skeleton_of(COCO_17)
    elbow = skeleton.names.index("left_elbow")
    poses_m = np.full((5, len(skeleton.names), 3), np.nan)
    poses_m[:, skeleton.parents[elbow]] = 0.0
    poses_m[:, elbow] = np.array([[0.29], [0.3], [0.31], [0.9], [np.nan]]) * [1.0, 0.0, 0.0]
    lengths = measure_lengths([poses_m, np.full_like(poses_m, np.nan)], skeleton)
    np.testing.assert_allclose(lengths.known_m[elbow], [0.305, np.nan])
    assert np.isnan(np.delete(lengths.known_m, elbow, axis=0)).all()
    assert unknown_lengths(skeleton).known_m.size == 0
