import numpy as np
import pytest

from pipeline.core.joints import COCO_17
from pipeline.validation.evaluation.pcp import HEAD_RULES, benchmark_joints, score_pcp

RNG = np.random.default_rng(5)
POSE = RNG.uniform(-0.5, 0.5, (14, 3))
FAR = POSE + np.array([5.0, 0.0, 0.0])


def test_perfect_predictions_get_full_marks() -> None:
    truth = np.stack([POSE, FAR])[:, None]
    scores = score_pcp([np.stack([FAR, POSE])], truth)
    np.testing.assert_allclose(scores.actors, 100.0)
    np.testing.assert_allclose(scores.mpjpe_mm, 0.0, atol=1e-9)
    np.testing.assert_array_equal(scores.chosen, [[1], [0]])


def test_part_is_right_up_to_half_its_length() -> None:
    """Move the right wrist by just under, then just over the forearm's length; the mean error is half of it."""
    length_m = np.linalg.norm(POSE[6] - POSE[7])
    for factor, percent in ((0.99, 100.0), (1.01, 50.0)):
        predicted = POSE.copy()
        predicted[6] += np.array([factor * length_m, 0.0, 0.0])
        scores = score_pcp([predicted[None]], POSE[None, None])
        assert scores.parts["lower_arms"][0] == percent
        assert scores.actors[0] == (100.0 if percent == 100.0 else 90.0)


def test_pck_counts_annotated_joints_within_150_mm() -> None:
    predicted = POSE.copy()
    predicted[:7, 0] += 0.149
    predicted[7:9, 0] += 0.151
    predicted[9] = np.nan
    truth = np.stack([POSE, POSE])[None]
    scores = score_pcp([predicted[None], np.empty((0, 14, 3))], truth)
    assert scores.pck150[0] == pytest.approx(100 * 11 / 28)


def test_missing_joints_and_missing_people_are_wrong() -> None:
    predicted = POSE.copy()
    predicted[0] = np.nan
    truth = np.stack([POSE, POSE])[None]
    scores = score_pcp([predicted[None], np.empty((0, 14, 3))], truth)
    assert scores.parts["lower_legs"][0] == 25.0
    assert scores.actors[0] == 45.0
    np.testing.assert_array_equal(scores.chosen, [[0, -1]])


def test_actor_who_is_never_annotated_has_no_score() -> None:
    truth = np.stack([POSE, np.full((14, 3), np.nan)])[:, None]
    scores = score_pcp([POSE[None]], truth)
    assert scores.actors[0] == 100.0
    assert np.isnan(scores.actors[1])


@pytest.mark.parametrize("rule", HEAD_RULES)
def test_limbs_come_by_name_and_heads_lie_above_neck(rule: str) -> None:
    coco = RNG.uniform(-0.3, 0.3, (17, 3))
    coco[COCO_17.indices(("left_shoulder", "right_shoulder")), 2] = 1.45
    coco[COCO_17.indices(("nose", "left_ear", "right_ear")), 2] = 1.65
    found = benchmark_joints(coco, rule)
    np.testing.assert_array_equal(found[0], coco[COCO_17.index("right_ankle")])
    np.testing.assert_array_equal(found[11], coco[COCO_17.index("left_wrist")])
    assert 1.45 < found[12, 2] < found[13, 2] < 1.9


def test_head_rules_differ_as_published() -> None:
    coco = np.zeros((17, 3))
    coco[COCO_17.index("nose")] = [1.0, 1.0, 1.0]
    coco[COCO_17.indices(("left_ear", "right_ear"))] = 0.8
    np.testing.assert_allclose(benchmark_joints(coco, "crossview")[12:], [[0.3, 0.4, 0.6], [0.78, 0.5, 1.5]])
    np.testing.assert_allclose(benchmark_joints(coco, "mvpose")[12:], [[0.5] * 3, [0.75, 0.75, 1.5]])
    np.testing.assert_allclose(benchmark_joints(coco, "ears")[12:], [[0.4] * 3, [1.2] * 3])
    np.testing.assert_allclose(benchmark_joints(coco, "voxelpose")[12], [0.475] * 3)
