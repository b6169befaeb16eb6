"""Fifty simulated takes with offsets up to a second: no wrong clock without a refusal or a warning."""

import numpy as np
import pytest

from pipeline.validation.simulation.scenes import SCENES
from tests.cases import accuracy_but
from tests.pipeline.capture.synchronization.conftest import cut_take, shortened

_SCENES = ("room", "walk", "unsynchronised", "handshake", "noisy")
_VIEWS = ((4, 8.0), (3, 5.0), (2, 8.0))


@pytest.mark.slow
# The first fifteen have each scene with each number of cameras.
@pytest.mark.parametrize("number", accuracy_but(range(15), range(50)))
def test_no_clock_is_wrong_by_half_frame_unnoticed(number: int) -> None:
    name = _SCENES[number % len(_SCENES)]
    num_views, duration_s = _VIEWS[number // len(_SCENES) % len(_VIEWS)]
    rate_hz = SCENES[name].clock.frame_rate_hz
    first_frames = np.random.default_rng(number).integers(0, int(rate_hz) + 1, num_views).tolist()
    take = cut_take(shortened(name, duration_s), number, first_frames)
    found = take.synchronized()
    offset_s = np.array([clock.offset_s for clock in found.clocks])
    errors_s = np.abs((offset_s - offset_s[0]) - (np.array(take.start_s) - take.start_s[0]))
    assert not found.is_certain or found.warnings or errors_s.max() < 0.5 / rate_hz
