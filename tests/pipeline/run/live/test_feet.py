"""Feet that stand, without later frames."""

import numpy as np
import pytest

from pipeline.run.live.feet import StandingFeet

RATE_HZ = 25.0
NOISE_M = 0.008


@pytest.fixture
def feet() -> StandingFeet:
    return StandingFeet()


def send(feet: StandingFeet, start_s: float, left_m: np.ndarray, right_m: np.ndarray) -> list[np.ndarray]:
    """Send located ankles of some frames with noise; return the places after each."""
    rng = np.random.default_rng(2)
    places_m = []
    for number, ankles_m in enumerate(np.stack([left_m, right_m], axis=1)):
        feet.update(start_s + number / RATE_HZ, ankles_m + rng.normal(0.0, NOISE_M, (2, 3)))
        places_m.append(feet.places_m)
    return places_m


def standing(x_m: float, z_m: float, num_frames: int) -> np.ndarray:
    return np.tile([x_m, 0.0, z_m], (num_frames, 1))


def test_foot_that_stands_has_steady_place_until_it_leaves(feet: StandingFeet) -> None:
    right_m = standing(0.3, 0.08, 50)
    places_m = send(feet, 0.0, standing(0.0, 0.08, 50), right_m)
    assert np.isnan(places_m[2]).all()
    assert np.isfinite(places_m[6:]).all()
    settled_m = np.array(places_m[12:])
    assert np.linalg.norm(settled_m - [[0.0, 0.0, 0.08], [0.3, 0.0, 0.08]], axis=-1).max() < NOISE_M
    assert np.linalg.norm(np.diff(settled_m, axis=0), axis=-1).max() * RATE_HZ < 0.06
    # A step: the foot leaves its place within three frames, and the other one stays.
    moving_m = standing(0.0, 0.12, 8) + np.arange(1, 9)[:, None] * [1.5 / RATE_HZ, 0.0, 0.0]
    places_m = send(feet, 2.0, moving_m, right_m[:8])
    assert np.isnan(places_m[2][0]).all()
    assert np.isnan(np.array(places_m[2:])[:, 0]).all()
    assert np.isfinite(np.array(places_m)[:, 1]).all()
    places_m = send(feet, 2.32, standing(0.48, 0.08, 20), right_m[:20])
    np.testing.assert_allclose(places_m[-1][0], [0.48, 0.0, 0.08], atol=NOISE_M)


def test_raised_foot_does_not_stand(feet: StandingFeet) -> None:
    places_m = np.array(send(feet, 0.0, standing(0.0, 0.45, 40), standing(0.3, 0.08, 40)))
    assert np.isnan(places_m[:, 0]).all()
    assert np.isfinite(places_m[10:, 1]).all()


def test_foot_that_nobody_sees_is_forgotten(feet: StandingFeet) -> None:
    send(feet, 0.0, standing(0.0, 0.08, 20), standing(0.3, 0.08, 20))
    unseen_m = np.full((2, 3), np.nan)
    feet.update(1.0, unseen_m)
    assert np.isfinite(feet.places_m).all()
    feet.update(1.5, unseen_m)
    assert np.isnan(feet.places_m).all()
