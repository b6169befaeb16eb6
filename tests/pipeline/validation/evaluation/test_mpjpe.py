"""Accuracy metrics on cases with known results."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.data.people import Source, Track3D
from pipeline.core.joints import COCO_17
from pipeline.validation.evaluation.mpjpe import (
    BODY_JOINTS,
    UNMATCHED,
    accuracy,
    count_switches,
    match_frames,
    select_joints,
)


def people(*starts_m: float, num_frames: int = 6, num_joints: int = 12) -> np.ndarray:
    """World positions (people, frames, joints, 3) of people who start on the x axis and walk along y."""
    body = np.random.default_rng(1).uniform([-0.3, -0.3, 0.0], [0.3, 0.3, 1.7], (num_joints, 3))
    steps = np.arange(num_frames)[:, None] * np.array([0.0, 0.05, 0.0])
    return np.array([body + steps[:, None] + np.array([start, 0.0, 0.0]) for start in starts_m])


def track(xyz_m: np.ndarray, start_frame: int = 0) -> Track3D:
    shape = xyz_m.shape[:2]
    source = np.where(np.isfinite(xyz_m[..., 0]), Source.MEASURED, Source.ABSENT)
    return Track3D(1, start_frame, xyz_m, np.ones(shape), source, np.ones(shape), np.full(shape, 2))


def test_perfect_tracks_are_perfect_whatever_their_order() -> None:
    truth = people(0.0, 2.0, 4.0)
    scores = accuracy(truth[[2, 0, 1]], truth)
    assert (scores.mpjpe_mm, scores.pck150, scores.recall) == (0.0, 1.0, 1.0)
    assert (scores.switches, scores.ghost_rate) == (0, 0.0)


def test_offset_is_error() -> None:
    truth = people(0.0, 3.0)
    predicted = truth.copy()
    predicted[0] += [0.03, 0.04, 0.0]
    scores = accuracy(predicted, truth)
    assert scores.mpjpe_mm == pytest.approx(25.0)
    assert scores.pck150 == 1.0


def test_swap_is_one_switch_person() -> None:
    truth = people(0.0, 2.0, 4.0)
    predicted = truth.copy()
    predicted[[0, 1], 3:] = truth[[1, 0], 3:]
    scores = accuracy(predicted, truth)
    assert scores.switches == 2
    assert scores.mpjpe_mm == 0.0


def test_gap_is_no_switch_but_new_track_is_one() -> None:
    assert count_switches(np.array([[0, UNMATCHED, UNMATCHED, 0, 0]])) == 0
    assert count_switches(np.array([[0, UNMATCHED, 1, 1, 0]])) == 2
    assert count_switches(np.array([[UNMATCHED, UNMATCHED, 3]])) == 0


def test_ghosts_are_share_of_what_was_predicted() -> None:
    truth = people(0.0)
    ghost = people(5.0)
    ghost[:, 2:] = np.nan
    scores = accuracy(np.concatenate([truth, ghost]), truth)
    assert scores.ghost_rate == pytest.approx(2 / 8)
    assert scores.recall == 1.0


def test_duplicate_is_ghost() -> None:
    truth = people(0.0)
    scores = accuracy(np.concatenate([truth + 0.05, truth]), truth)
    assert scores.ghost_rate == 0.5
    assert scores.mpjpe_mm == 0.0


def test_gate() -> None:
    truth = people(0.0)
    at_gate, beyond = (truth + np.array([offset, 0.0, 0.0]) for offset in (0.499, 0.501))
    inside, outside = accuracy(at_gate, truth), accuracy(beyond, truth)
    assert inside.mpjpe_mm == pytest.approx(499.0)
    assert (inside.recall, inside.pck150, inside.ghost_rate) == (1.0, 0.0, 0.0)
    assert outside.mpjpe_mm is None
    assert (outside.recall, outside.pck150, outside.ghost_rate) == (0.0, 0.0, 1.0)


def test_pck_counts_missing_joints_people_and_frames() -> None:
    truth = people(0.0, 2.0)
    predicted = truth[:1].copy()
    predicted[0, 0, :3] = np.nan
    predicted[0, 1, 0] += [0.151, 0.0, 0.0]
    predicted[0, 1, 1] += [0.149, 0.0, 0.0]
    scores = accuracy(predicted, truth)
    assert scores.pck150 == pytest.approx((6 * 12 - 3 - 1) / (2 * 6 * 12))
    assert scores.mpjpe_mm == pytest.approx((151 + 149) / (6 * 12 - 3))
    assert scores.recall == 0.5


def test_absent_people_are_neither_missed_nor_matched() -> None:
    truth = people(0.0, 2.0)
    truth[1, :4] = np.nan
    scores = accuracy(people(0.0), truth)
    assert scores.recall == pytest.approx(6 / 8)
    assert scores.pck150 == pytest.approx(6 / 8)


def test_assignment_is_best_of_all_not_greedy_one() -> None:
    truth = people(0.0, 0.3, num_frames=1)
    # Track 0 is nearest to person 1, but person 0 would then be left with a track out of reach.
    predicted = people(0.2, 0.55, num_frames=1)
    assert match_frames(predicted, truth).tolist() == [[0], [1]]


def test_many_pairs_come_before_close_ones() -> None:
    truth = people(0.0, 0.45, num_frames=1)
    predicted = people(0.45, 0.9, num_frames=1)
    assert match_frames(predicted, truth).tolist() == [[0], [1]]


@pytest.mark.parametrize("shape", [(0, 3), (3, 0), (0, 0)])
def test_nobody(shape: tuple[int, int]) -> None:
    num_tracks, num_people = shape
    scores = accuracy(
        people(*range(num_tracks)).reshape(-1, 6, 12, 3), people(*range(num_people)).reshape(-1, 6, 12, 3)
    )
    assert scores.mpjpe_mm is None
    assert scores.recall == (0.0 if num_people else None)
    assert scores.ghost_rate == (1.0 if num_tracks else None)


@given(order=st.permutations(range(4)), flip=st.booleans())
def test_order_of_people_and_tracks_does_not_matter(order: list[int], flip: bool) -> None:
    truth = people(0.0, 0.6, 1.1, 3.0)
    predicted = truth + np.random.default_rng(3).normal(0, 0.1, truth.shape)
    predicted[1, 2:4] = np.nan
    reordered = accuracy(predicted[order], truth[order[::-1]] if flip else truth)
    expected = accuracy(predicted, truth)
    assert reordered.mpjpe_mm == pytest.approx(expected.mpjpe_mm)
    assert (reordered.switches, reordered.recall) == (expected.switches, expected.recall)


def test_joints_are_selected_by_name_and_output_frame() -> None:
    xyz_m = np.arange(3 * 17 * 3, dtype=float).reshape(3, 17, 3)
    taken = select_joints(
        [track(xyz_m, start_frame=10)], COCO_17, ("left_wrist", "tail", "nose"), np.array([9, 10, 12, 13, -1])
    )
    assert taken.shape == (1, 5, 3, 3)
    np.testing.assert_array_equal(taken[0, 1, 0], xyz_m[0, COCO_17.index("left_wrist")])
    np.testing.assert_array_equal(taken[0, 2, 2], xyz_m[2, 0])
    assert np.isnan(taken[0, [0, 3, 4]]).all()
    assert np.isnan(taken[:, :, 1]).all()


def test_twelve_joints_without_face() -> None:
    assert len(BODY_JOINTS) == 12
    assert set(COCO_17.names) - set(BODY_JOINTS) == {"nose", "left_eye", "right_eye", "left_ear", "right_ear"}
