from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.detection.decoders.movenet import decode_movenet

SHAPE = (64, 96)
JOINTS = range(17)


class Heads:
    """Maps of a network with cells of 4 pixels, to which bodies and peaks are added."""

    def __init__(self) -> None:
        self.center = np.zeros((1, 1, *SHAPE), np.float32)
        self.heatmap = np.zeros((1, 17, *SHAPE), np.float32)
        self.offset = np.zeros((1, 34, *SHAPE), np.float32)
        self.regress = np.zeros((1, 34, *SHAPE), np.float32)

    def add_center(self, cell_yx: tuple[int, int], joints_px: np.ndarray, score: float) -> None:
        """Add a body whose centre regresses its joints to these positions."""
        y, x = cell_yx
        self.center[0, 0, y, x] = score
        self.regress[0, 0::2, y, x] = joints_px[:, 1] / 4 - y
        self.regress[0, 1::2, y, x] = joints_px[:, 0] / 4 - x

    def add_peaks(self, joints: Sequence[int], joints_px: np.ndarray, heat: float) -> None:
        """Add heatmap peaks of some joints at exactly these positions."""
        channel = np.array(joints)
        x, y = (joints_px[channel] / 4).T
        row, column = np.floor(y).astype(int), np.floor(x).astype(int)
        self.heatmap[0, channel, row, column] = heat
        self.offset[0, 2 * channel, row, column] = y - row
        self.offset[0, 2 * channel + 1, row, column] = x - column

    def outputs(self) -> dict[str, np.ndarray]:
        return {"center": self.center, "heatmap": self.heatmap, "offset": self.offset, "regress": self.regress}


def person(x_px: float, y_px: float, seed: int = 0) -> np.ndarray:
    """Random joints in a box of 60 by 120 pixels."""
    return np.random.default_rng(seed).uniform((x_px, y_px), (x_px + 60, y_px + 120), (17, 2))


def test_bodies_are_located_within_cell_and_sorted_by_score() -> None:
    heads = Heads()
    left_px, right_px = person(20.3, 30.7), person(250.2, 90.9, seed=1)
    for cell_yx, joints_px, score in [((20, 12), left_px, 0.5), ((37, 70), right_px, 0.75)]:
        heads.add_center(cell_yx, joints_px, score)
        heads.add_peaks(JOINTS, joints_px, heat=0.625)
    bodies = decode_movenet(heads.outputs())
    np.testing.assert_allclose(bodies.keypoints_px, [right_px, left_px], atol=1e-4)
    assert bodies.center_score.tolist() == [0.75, 0.5]
    assert (bodies.score == 0.625).all()
    np.testing.assert_allclose(bodies.box_px[0], [*right_px.min(0), *right_px.max(0)], atol=1e-4)


@settings(max_examples=50)
@given(seed=st.integers(0, 10**6), x_px=st.floats(0, 300), y_px=st.floats(0, 120))
def test_one_body_is_found_wherever_it_is(seed: int, x_px: float, y_px: float) -> None:
    heads = Heads()
    joints_px = person(x_px, y_px, seed)
    heads.add_center((31, 47), joints_px, 0.9)
    heads.add_peaks(JOINTS, joints_px, heat=0.9)
    np.testing.assert_allclose(decode_movenet(heads.outputs()).keypoints_px, [joints_px], atol=1e-4)


def test_empty_image_has_no_bodies() -> None:
    bodies = decode_movenet(Heads().outputs())
    assert bodies.keypoints_px.shape == (0, 17, 2)
    assert bodies.score.shape == (0, 17)
    assert bodies.box_px.shape == (0, 4)
    assert bodies.center_score.shape == (0,)


def test_centre_or_joints_alone_are_no_bodies() -> None:
    heads = Heads()
    heads.add_center((30, 40), person(130, 60), 0.9)
    assert len(decode_movenet(heads.outputs()).score) == 0
    heads = Heads()
    heads.add_center((30, 40), person(130, 60), 0.29)
    heads.add_peaks(JOINTS, person(130, 60), 0.9)
    assert len(decode_movenet(heads.outputs()).score) == 0


def test_joint_without_peak_is_nan_with_score_0() -> None:
    heads = Heads()
    joints_px = person(100, 40)
    heads.add_center((25, 32), joints_px, 0.9)
    heads.add_peaks(JOINTS[3:], joints_px, 0.9)
    heads.add_peaks(JOINTS[2:3], joints_px, 0.04)
    bodies = decode_movenet(heads.outputs())
    assert np.isnan(bodies.keypoints_px[0, :3]).all()
    assert bodies.score[0].tolist() == pytest.approx([0] * 3 + [0.9] * 14)


def test_there_is_no_limit_of_six_people() -> None:
    heads = Heads()
    people = [person(7.3 + 70 * (k % 5), 3.1 + 125 * (k // 5), seed=k) for k in range(10)]
    for k, joints_px in enumerate(people):
        row, column = (joints_px.mean(0)[::-1] / 4).astype(int)
        heads.add_center((row, column), joints_px, 0.95 - 0.05 * k)
        heads.add_peaks(JOINTS, joints_px, 0.5)
    np.testing.assert_allclose(decode_movenet(heads.outputs()).keypoints_px, people, atol=1e-4)


def test_second_centre_of_same_person_is_left_out() -> None:
    heads = Heads()
    joints_px = person(100, 40)
    heads.add_center((25, 32), joints_px, 0.7)
    heads.add_center((27, 32), joints_px + 3, 0.8)
    heads.add_peaks(JOINTS, joints_px, 0.9)
    # A passer-by's joint that the twin could take once all of its own are gone.
    heads.add_peaks([4], joints_px + 12, 0.9)
    bodies = decode_movenet(heads.outputs())
    assert bodies.center_score.tolist() == pytest.approx([0.8])
    np.testing.assert_allclose(bodies.keypoints_px[0], joints_px, atol=1e-4)


@pytest.mark.parametrize("scores", [(0.9, 0.6), (0.6, 0.9)])
def test_overlapping_people_get_best_fitting_peak(scores: tuple[float, float]) -> None:
    heads = Heads()
    front_px, back_px = person(100, 40), person(112, 44, seed=1)
    expected_px = back_px.copy()
    # Two hidden joints, which the body behind expects near the front person's; one of them has a faint peak of its own.
    expected_px[[9, 10]] = front_px[[9, 10]] + 4
    back_px[10] = front_px[10] + 14
    heads.add_center((25, 32), front_px, scores[0])
    heads.add_center((26, 36), expected_px, scores[1])
    heads.add_peaks(JOINTS, front_px, 0.9)
    heads.add_peaks([k for k in JOINTS if k not in (9, 10)], back_px, 0.4)
    heads.add_peaks([10], back_px, 0.1)
    bodies = decode_movenet(heads.outputs())
    front, back = (0, 1) if scores[0] > scores[1] else (1, 0)
    np.testing.assert_allclose(bodies.keypoints_px[front], front_px, atol=1e-4)
    back_px[9] = np.nan
    np.testing.assert_allclose(bodies.keypoints_px[back], back_px, atol=1e-4)
    assert bodies.score[back, 9] == 0
    assert bodies.score[back, 10] == pytest.approx(0.1)


def test_peak_far_from_where_body_expects_it_is_someone_elses() -> None:
    heads = Heads()
    joints_px = person(100, 40)
    heads.add_center((25, 32), joints_px, 0.9)
    heads.add_peaks(JOINTS[1:], joints_px, 0.9)
    heads.add_peaks([0], joints_px + np.array([150, 0]), 1.0)
    assert np.isnan(decode_movenet(heads.outputs()).keypoints_px[0, 0]).all()


def test_plateau_is_one_peak() -> None:
    heads = Heads()
    joints_px = person(100, 40)
    for cell_yx in [(25, 32), (25, 33), (26, 32), (26, 33)]:
        heads.add_center(cell_yx, joints_px, 0.9)
    heads.add_peaks(JOINTS, joints_px, 0.9)
    assert len(decode_movenet(heads.outputs()).score) == 1


def test_peaks_in_corners_of_map_count() -> None:
    heads = Heads()
    joints_px = person(0, 0)
    height, width = SHAPE
    joints_px[:4] = [(0, 0), (4 * width - 1, 0), (0, 4 * height - 1), (4 * width - 1, 4 * height - 1)]
    heads.add_center((0, 0), joints_px, 0.9)
    heads.add_peaks(JOINTS, joints_px, 0.9)
    np.testing.assert_allclose(decode_movenet(heads.outputs()).keypoints_px[0], joints_px, atol=1e-4)
