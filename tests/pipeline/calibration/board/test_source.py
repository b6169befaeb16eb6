"""Frames of a video in which the board is looked for."""

import numpy as np
import pytest

from pipeline.calibration.board.source import frames_to_look_at
from pipeline.core.options.job_choices import BOARD_FRAMES


@pytest.mark.parametrize("rate_hz", [25.0, 30000 / 1001, 60000 / 1001])
def test_all_frames_of_short_video_are_looked_at(rate_hz: float) -> None:
    for number in range(1, 121):
        time_s = 3.7 + np.arange(number) / rate_hz
        assert frames_to_look_at(time_s, (time_s[0], time_s[-1]), 1 / rate_hz) == list(range(number))


def test_frames_of_long_video_are_spread_from_first_to_last() -> None:
    time_s = np.arange(10 * BOARD_FRAMES) / 25.0
    frames = frames_to_look_at(time_s, (time_s[0], time_s[-1]), 1 / 25.0)
    assert (frames[0], frames[-1], len(frames)) == (0, 10 * BOARD_FRAMES - 1, BOARD_FRAMES)
    assert set(np.diff(frames)) <= {10, 11}
