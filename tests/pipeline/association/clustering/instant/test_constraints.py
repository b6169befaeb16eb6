import numpy as np

from pipeline.association.clustering.instant.constraints import fits, length_error, nearly_fits
from pipeline.association.clustering.instant.evidence import JointPoints, Membership
from pipeline.association.clustering.skeleton import LimbLengths, clustering_skeleton, measure_lengths, unknown_lengths
from pipeline.core.joints import COCO_17


def test_membership_is_share_of_views_that_agree() -> None:
    evidence = Membership(clustering_skeleton(COCO_17), 0.6)
    parents = places(np.array([[0, 1, 2, -1], [3, -1, -1, 5]]))
    points = places(np.array([[0, 1, -1, -1], [0, 7, -1, -1], [-1, -1, -1, 5], [-1, 1, -1, -1]]))
    score = evidence.connect(parents, points, np.ones((2, 4), bool))
    np.testing.assert_array_equal(score, [[1.0, 0.5, np.nan, 1.0], [0.0, 0.0, 1.0, np.nan]])
    found = fits(score, evidence.least[points.joint], np.zeros((2, 4)), tau3=0.1)
    np.testing.assert_array_equal(found[0], [True, False, True, True])
    unwanted = evidence.connect(parents, points, np.zeros((2, 4), bool))
    assert np.isnan(unwanted).all()


def test_one_of_connectivity_and_length_may_be_missed() -> None:
    score = np.array([[0.4, 0.4, 0.2, 0.2, 0.1, 0.2]])
    error = np.array([[0.1, 0.2, 0.1, 0.2, 0.0, 0.1]])
    is_measured = np.array([True, True, True, True, True, False])
    least = np.full(6, 0.3)
    np.testing.assert_array_equal(fits(score, least, error, 0.1)[0], [True, *5 * [False]])
    near = nearly_fits(score, least, error, 0.1, is_measured, leniency=2.0)[0]
    np.testing.assert_array_equal(near, [True, True, True, False, False, False])


def places(body: np.ndarray) -> JointPoints:
    return JointPoints(np.ones(len(body), int), np.zeros((len(body), 3)), body)


def test_length_fits_nearest_of_known() -> None:
    skeleton = clustering_skeleton(COCO_17)
    shoulder, elbow, wrist = skeleton.indices(("left_shoulder", "left_elbow", "left_wrist"))
    known_m = np.full((len(skeleton.names), 2), np.nan)
    known_m[elbow] = [0.30, 0.40]
    lengths = LimbLengths(known_m, np.full(len(skeleton.names), 0.5))
    parent = JointPoints(np.array([shoulder]), np.zeros((1, 3)), np.zeros((1, 4), int))
    points_m = np.array([[0.33, 0.0, 0.0], [0.0, 0.38, 0.0], [0.0, 0.0, 0.49], [0.6, 0.0, 0.0]])

    def error(parent: JointPoints, joint: int) -> np.ndarray:
        points = JointPoints(np.full(4, joint), points_m, np.zeros((4, 4), int))
        return length_error(parent, points, skeleton, lengths)

    np.testing.assert_allclose(error(parent, elbow), [[0.1, 0.05, 0.225, np.inf]])
    np.testing.assert_array_equal(error(parent, wrist), np.full((1, 4), np.inf))  # no limb leads there
    unknown = error(parent._replace(joint=np.array([elbow])), wrist)
    np.testing.assert_array_equal(unknown, [[0.0, 0.0, 0.0, np.inf]])


def test_lengths_are_persons_medians() -> None:
    skeleton = clustering_skeleton(COCO_17)
    elbow = skeleton.names.index("left_elbow")
    poses_m = np.full((5, len(skeleton.names), 3), np.nan)
    poses_m[:, skeleton.parents[elbow]] = 0.0
    poses_m[:, elbow] = np.array([[0.29], [0.3], [0.31], [0.9], [np.nan]]) * [1.0, 0.0, 0.0]
    lengths = measure_lengths([poses_m, np.full_like(poses_m, np.nan)], skeleton)
    np.testing.assert_allclose(lengths.known_m[elbow], [0.305, np.nan])
    assert np.isnan(np.delete(lengths.known_m, elbow, axis=0)).all()
    assert unknown_lengths(skeleton).known_m.size == 0


def test_error_is_that_of_best_of_many_lengths() -> None:
    skeleton = clustering_skeleton(COCO_17)
    shoulder, elbow = skeleton.names.index("left_shoulder"), skeleton.names.index("left_elbow")
    rng = np.random.default_rng(0)
    known_m = np.full((len(skeleton.names), 40), np.nan)
    known_m[elbow, :30] = rng.uniform(0.15, 0.45, 30)
    lengths = LimbLengths(known_m, np.array(skeleton.longest_m))
    distance_m = rng.uniform(0.03, 0.49, 500)
    parents = JointPoints(np.array([shoulder]), np.zeros((1, 3)), np.zeros((1, 2), int))
    points = JointPoints(np.full(500, elbow), distance_m[:, None] * [1.0, 0.0, 0.0], np.zeros((500, 2), int))
    of_each = np.abs(distance_m[:, None] - known_m[elbow, :30]) / known_m[elbow, :30]
    np.testing.assert_array_equal(length_error(parents, points, skeleton, lengths)[0], of_each.min(1))
