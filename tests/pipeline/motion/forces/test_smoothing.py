"""Smoothing of positions: known noise, known cutoff, free falls."""

import numpy as np
import pytest

from pipeline.motion.balance.compute import GRAVITY_M_S2
from pipeline.motion.forces.smoothing import PathSmoother, likeliest, penalty_of

RATE_HZ = 100.0
TIME_S = np.arange(400) / RATE_HZ
EVERY = np.ones(len(TIME_S), bool)


def test_penalty_halves_movements_of_its_cutoff() -> None:
    smoother = PathSmoother(EVERY, penalty_of(5.0, RATE_HZ), RATE_HZ)
    slow, cutoff, fast = (smoother.path(np.sin(2 * np.pi * hz * TIME_S)[:, None])[100:300] for hz in (1.0, 5.0, 20.0))
    assert np.abs(slow).max() == pytest.approx(1.0, abs=0.01)
    assert np.abs(cutoff).max() == pytest.approx(0.5, abs=0.02)
    assert np.abs(fast).max() < 0.01


def test_parabola_passes_and_its_acceleration_is_exact() -> None:
    smoother = PathSmoother(EVERY, 1e6, RATE_HZ)
    path = smoother.path((3.0 * TIME_S**2 - TIME_S)[:, None])
    np.testing.assert_allclose(smoother.acceleration(path), 6.0, atol=1e-4)


def test_noise_and_acceleration_are_within_stated_deviations() -> None:
    rng = np.random.default_rng(4)
    jerk = rng.normal(0.0, 30.0, (len(TIME_S), 3))
    path_m = np.cumsum(np.cumsum(np.cumsum(jerk, 0), 0), 0) / RATE_HZ**3
    smoother, sigma_m = likeliest(path_m + rng.normal(0.0, 0.002, path_m.shape), EVERY, RATE_HZ)
    assert sigma_m == pytest.approx(0.002, rel=0.1)
    found = smoother.acceleration(smoother.path(path_m + rng.normal(0.0, 0.002, path_m.shape)))
    error = found - smoother.acceleration(path_m)
    gain = smoother.acceleration_gains(np.ones(1))[:, :1] * sigma_m
    assert 0.7 < np.sqrt((error**2).mean()) / np.sqrt((gain**2).mean()) < 1.3


def test_unknown_frames_have_larger_deviations_and_no_effect() -> None:
    known = EVERY.copy()
    known[190:220] = False
    values = np.sin(3.0 * TIME_S)[:, None]
    smoother = PathSmoother(known, penalty_of(5.0, RATE_HZ), RATE_HZ)
    spoilt = np.where(known[:, None], values, 99.0)
    np.testing.assert_allclose(smoother.path(spoilt), smoother.path(values), atol=1e-9)
    gains = smoother.acceleration_gains(np.ones(1))[:, 0]
    assert gains[205] > 1.2 * gains[100]


def test_lasting_noise_moves_accelerations_less() -> None:
    smoother = PathSmoother(EVERY, penalty_of(6.0, RATE_HZ), RATE_HZ)
    lags = np.arange(60)
    short, long = (smoother.acceleration_gains(np.exp(-0.5 * (lags / of) ** 2))[200, 1] for of in (3.0, 12.0))
    assert long < short / 3.0


def test_gains_do_not_depend_on_blocks() -> None:
    whole = PathSmoother(EVERY, penalty_of(6.0, RATE_HZ), RATE_HZ).acceleration_gains(np.ones(1))
    short = PathSmoother(EVERY[:150], penalty_of(6.0, RATE_HZ), RATE_HZ).acceleration_gains(np.ones(1))
    np.testing.assert_allclose(whole[150:250], np.tile(short[75], (100, 1)), rtol=1e-6)


def test_body_falls_freely_in_flights() -> None:
    falls = (TIME_S > 1.5) & (TIME_S < 2.0)
    smoother = PathSmoother(EVERY, penalty_of(6.0, RATE_HZ), RATE_HZ)
    truth = np.where(falls, -GRAVITY_M_S2, GRAVITY_M_S2 * falls.sum() / (~falls).sum())
    height_m = np.cumsum(np.cumsum(truth)) / RATE_HZ**2
    values_m = np.stack([TIME_S, 0.0 * TIME_S, height_m], axis=1)
    found = smoother.acceleration(smoother.path_with_falls(values_m, 0.001, falls))
    free = smoother.acceleration(smoother.path(values_m))
    inside = falls & np.roll(falls, 1) & np.roll(falls, -1)
    assert np.abs(found[inside] - [0.0, 0.0, -GRAVITY_M_S2]).max() < 0.5
    assert np.abs(free[inside, 2] + GRAVITY_M_S2).max() > 3.0


def test_place_of_the_origin_does_not_matter() -> None:
    falls = (TIME_S > 1.5) & (TIME_S < 2.0)
    smoother = PathSmoother(EVERY, penalty_of(2.0, RATE_HZ), RATE_HZ)
    values_m = np.stack([TIME_S, np.cos(TIME_S), np.sin(TIME_S)], axis=1)
    near, far = (smoother.acceleration(smoother.path(values_m + away_m)) for away_m in (0.0, 5e6))
    np.testing.assert_allclose(far, near, atol=2e-4)
    near, far = (
        smoother.acceleration(smoother.path_with_falls(values_m + away_m, 0.001, falls)) for away_m in (0.0, 5e6)
    )
    np.testing.assert_allclose(far, near, atol=2e-4)
