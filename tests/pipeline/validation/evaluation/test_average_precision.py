"""Average precision of poses on cases with known results."""

import numpy as np
import pytest

from pipeline.validation.evaluation.average_precision import InstantPoses, score_poses

BODY_M = np.random.default_rng(1).uniform([-0.3, -0.3, 0.0], [0.3, 0.3, 1.7], (8, 3))


def person(x_m: float) -> np.ndarray:
    return BODY_M + np.array([x_m, 0.0, 0.0])


def instant(*poses: tuple[float, float]) -> InstantPoses:
    """Poses at some x, with scores."""
    return InstantPoses(
        np.array([person(x_m) for x_m, _ in poses]).reshape(-1, 8, 3), np.array([score for _, score in poses])
    )


def test_perfect_poses() -> None:
    truth_m = [np.array([person(0.0), person(2.0)]), np.array([person(1.0)])]
    scores = score_poses([instant((2.0, 0.5), (0.0, 0.9)), instant((1.0, 0.7))], truth_m)
    assert (scores.mean_ap, scores.recall_500, scores.mpjpe_500_mm) == (1.0, 1.0, 0.0)


def test_error_counts_from_threshold_above_it() -> None:
    scores = score_poses([instant((0.06, 0.9))], [np.array([person(0.0)])])
    assert scores.ap == {25: 0.0, 50: 0.0, 75: 1.0, 100: 1.0, 125: 1.0, 150: 1.0}
    assert scores.mean_ap == pytest.approx(4 / 6)
    assert scores.mpjpe_500_mm == pytest.approx(60.0)


def test_false_pose_of_higher_score_lowers_precision() -> None:
    truth_m = [np.array([person(0.0), person(2.0)])]
    # By falling score: right, false, right. Precision is 1 up to half of the people, then 2/3.
    scores = score_poses([instant((0.0, 0.9), (9.0, 0.8), (2.0, 0.7))], truth_m)
    assert scores.ap[25] == pytest.approx(0.5 * 1.0 + 0.5 * 2 / 3)
    # A false pose of the lowest score costs nothing.
    assert score_poses([instant((0.0, 0.9), (9.0, 0.1), (2.0, 0.7))], truth_m).ap[25] == pytest.approx(1.0)


def test_second_pose_of_person_is_false() -> None:
    scores = score_poses([instant((0.1, 0.9), (0.0, 0.8), (2.0, 0.7))], [np.array([person(0.0), person(2.0)])])
    assert scores.ap[150] == pytest.approx(0.5 + 0.5 * 2 / 3)
    # At 25 mm the first one is false.
    assert scores.ap[25] == pytest.approx(0.5 * 2 / 3 + 0.5 * 2 / 3)
    assert scores.mpjpe_500_mm == pytest.approx(50.0)


def test_people_at_other_instants_are_others() -> None:
    scores = score_poses([instant((0.0, 0.9)), instant()], [np.array([person(0.0)])] * 2)
    assert (scores.recall_500, scores.ap[25]) == (0.5, 0.5)
    # A pose at an instant without people is false.
    scores = score_poses([instant((0.0, 0.9)), instant((0.0, 0.95))], [np.array([person(0.0)]), np.empty((0, 8, 3))])
    assert scores.ap[25] == pytest.approx(0.5)


def test_few_joints_are_no_pose_of_person() -> None:
    truth_m = person(0.0)
    truth_m[4:] = np.nan
    poses = instant((0.0, 0.9))
    poses.xyz_m[0, 1:] = np.nan
    assert score_poses([poses], [truth_m[None]]).recall_500 == 0.0
    poses.xyz_m[0, 1] = BODY_M[1]
    assert score_poses([poses], [truth_m[None]]).recall_500 == 1.0


def test_nobody() -> None:
    scores = score_poses([], [])
    assert (scores.mean_ap, scores.recall_500, scores.mpjpe_500_mm) == (None, None, None)
    scores = score_poses([instant()], [np.array([person(0.0)])])
    assert (scores.mean_ap, scores.recall_500, scores.mpjpe_500_mm) == (0.0, 0.0, None)
