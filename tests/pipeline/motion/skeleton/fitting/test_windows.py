from itertools import pairwise

import numpy as np
import pytest

from pipeline.motion.skeleton.fitting.windows import Blend, windows


@pytest.mark.parametrize("num_frames", [1, 60, 599, 600, 601, 660, 1140, 1141, 5000])
def test_windows_cover_all_frames_and_overlap(num_frames: int) -> None:
    rows = list(windows(num_frames))
    assert rows[0].start == 0
    assert rows[-1].stop == num_frames
    for before, after in pairwise(rows):
        assert before.stop - after.start == 60
    assert max(one.stop - one.start for one in rows) <= 600


def test_equal_windows_blend_to_the_same() -> None:
    values = np.random.default_rng(0).normal(size=(1500, 4, 3))
    result = np.empty((1500, 4, 3))
    blend = Blend(result)
    for rows in windows(1500):
        blend.add(rows, values[rows])
    np.testing.assert_allclose(result, values)


def test_windows_that_differ_pass_evenly_into_each_other() -> None:
    result = np.empty((1100, 1))
    blend = Blend(result)
    for number, rows in enumerate(windows(1100)):
        blend.add(rows, np.full((rows.stop - rows.start, 1), float(number)))
    steps = np.diff(result[:, 0])
    assert steps.min() >= 0.0
    assert steps.max() < 0.02


def test_what_one_window_does_not_know_the_other_one_says() -> None:
    result = np.empty((1100, 1))
    blend = Blend(result)
    first, second = windows(1100)
    blend.add(first, np.full((600, 1), np.nan))
    blend.add(second, np.ones((second.stop - second.start, 1)))
    assert np.isnan(result[:540]).all()
    assert (result[540:] == 1.0).all()
