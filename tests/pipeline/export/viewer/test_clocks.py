import numpy as np

from pipeline.export.viewer.description import TOLERANCE_S, knots


def test_steady_camera_has_two_knots() -> None:
    assert knots((np.arange(5000) / 29.97)[:, None]) == [0, 4999]


def test_single_frame_has_one_knot() -> None:
    assert knots(np.array([[3.0]])) == [0]


def test_pauses_and_rounded_times_are_kept_within_tolerance() -> None:
    own_s = np.round(np.arange(900) / 30.0, 3)
    session_s = own_s + np.where(np.arange(900) >= 400, 2.5, 0.0)
    times_s = np.stack([session_s, own_s], axis=1)
    found = knots(times_s)
    assert found == [0, 399, 400, 899]
    for column in range(2):
        interpolated_s = np.interp(np.arange(900), found, times_s[found, column])
        assert np.abs(interpolated_s - times_s[:, column]).max() <= TOLERANCE_S
