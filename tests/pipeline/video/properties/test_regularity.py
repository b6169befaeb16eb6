"""Dropped frames: their number and their places."""

import numpy as np
import pytest

from pipeline.video.properties.regularity import uneven_times

REGULAR_S = np.arange(300) / 29.97


def test_regular_and_rounded_times_are_not_worth_a_word() -> None:
    assert uneven_times(REGULAR_S) == []
    assert uneven_times(np.round(REGULAR_S, 3)) == []
    assert uneven_times(np.floor(np.arange(200) * 60 / 24) / 60) == []  # 24 Hz on a clock of 60 Hz
    assert uneven_times(np.array([0.0])) == []
    assert uneven_times(np.array([0.0, 5.0])) == []


def test_gaps_are_counted_and_placed() -> None:
    (warning,) = uneven_times(np.delete(REGULAR_S, [100, 101, 102, 200]))
    assert warning.code == "frames_dropped"
    assert warning.message == "4 frames are missing, at 3.30, 6.64 s; the longest gap is 0.133 s."
    (one,) = uneven_times(np.delete(REGULAR_S, 50))
    assert one.message.startswith("1 frame is missing, at 1.63 s;")
    (many,) = uneven_times(np.delete(REGULAR_S, range(10, 290, 14)))
    assert many.message.startswith("20 frames are missing, at 0.30, 0.77, 1.23, 1.70, 2.17 s and 15 more times;")


def test_frames_at_almost_one_time_are_said() -> None:
    (warning,) = uneven_times(np.sort(np.append(REGULAR_S, REGULAR_S[90] + 0.002)))
    assert warning.code == "frames_too_close"
    assert warning.message == "1 frame follows the one before at once, at 3.01 s."


def test_a_rate_that_varies_is_said_once() -> None:
    intervals_s = np.random.default_rng(0).exponential(0.04, 300)
    (warning,) = uneven_times(np.cumsum(intervals_s))
    assert warning.code == "frame_rate_varies"


@pytest.mark.parametrize("factor", [1.5, 0.5])
def test_jitter_is_no_gap(factor: float) -> None:
    intervals_s = np.full(100, 0.04)
    intervals_s[40] *= factor
    assert uneven_times(np.cumsum(intervals_s)) == []
