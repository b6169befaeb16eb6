"""Angles over cycles: stretched to 0 to 100 percent, without cycles that are not wholly known."""

import numpy as np

from pipeline.motion.angles.cycles import NUM_POINTS, normalised_cycles


def test_cycles_of_different_lengths_are_stretched_to_the_same_percents() -> None:
    # An angle that goes from 0 to 60 and back in each cycle, one of 40 frames and one of 25.5.
    rows = np.arange(80)
    phase = np.where(rows < 45, (rows - 5.0) / 40.0, (rows - 45.0) / 25.5)
    angle_deg = 30.0 - 30.0 * np.cos(2 * np.pi * phase)
    found = normalised_cycles(angle_deg, [(5.0, 45.0), (45.0, 70.5)])
    assert found.shape == (2, NUM_POINTS)
    expected = 30.0 - 30.0 * np.cos(2 * np.pi * np.linspace(0.0, 1.0, NUM_POINTS))
    np.testing.assert_allclose(found, [expected, expected], atol=0.5)


def test_cycles_with_unknown_angles_or_beyond_the_frames_are_left_out() -> None:
    angle_deg = np.arange(50.0)
    angle_deg[20] = np.nan
    cycles = [
        (0.0, 10.0),
        (12.5, 19.0),
        (12.5, 19.2),
        (15.0, 30.0),
        (40.0, 49.0),
        (45.0, 49.5),
        (-1.0, 5.0),
        (9.0, 9.0),
    ]
    found = normalised_cycles(angle_deg, cycles)
    np.testing.assert_allclose(found[:, [0, -1]], [[0.0, 10.0], [12.5, 19.0], [40.0, 49.0]])
    assert normalised_cycles(angle_deg, []).shape == (0, NUM_POINTS)
