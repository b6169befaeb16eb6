"""Body proportions: measurement, likelihood of one person, and changes."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from pipeline.association.identity.proportions import (
    NUM_LIMBS,
    LimbProportions,
    Measured,
    changes,
    limb_lengths_m,
    measure,
    spread_of_a_second_m,
)
from pipeline.core.joints import COCO_17
from tests.pipeline.association.identity.people import RATE_HZ, person, walker
from tests.pipeline.conftest import ring_camera

CAMERAS = (ring_camera("a", 0.0), ring_camera("b", 1.5))
SPREAD_M = np.full(NUM_LIMBS, 0.02)


def lengths_of(build: int, num_frames: int) -> np.ndarray:
    track, _ = person(walker((0, 0), (1, 0), num_frames, build), CAMERAS)
    return limb_lengths_m(track, COCO_17)


def test_both_sides_of_limb_are_measured() -> None:
    lengths_m = lengths_of(1, 50)
    assert lengths_m.shape == (50, NUM_LIMBS, 2)
    lengths_m[:, 0, 0] = np.nan
    measured = measure(lengths_m, RATE_HZ)
    np.testing.assert_allclose(measured.median_m[0], np.median(lengths_m[:, 0, 1]))
    np.testing.assert_allclose(measured.duration_s, [1.0, *[2.0] * (NUM_LIMBS - 1)])


def test_moment_is_no_measurement() -> None:
    measured = measure(lengths_of(1, 3), RATE_HZ)
    assert np.isnan(measured.median_m).all()
    assert (measured.duration_s == 0).all()


def test_joint_that_detector_lacks_is_no_measurement() -> None:
    track, _ = person(walker((0, 0), (1, 0), 50, 1), CAMERAS)
    from_elbows = limb_lengths_m(track, type(COCO_17)(tuple(f"other_{name}" for name in COCO_17.names), ()))
    assert np.isnan(from_elbows).all()


@given(st.integers(0, 2**32 - 1), st.integers(2, 4))
def test_likelihood_of_one_person_is_joint_normal(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    length_m = rng.uniform(0.2, 0.6, NUM_LIMBS)
    measured = [
        Measured(length_m * rng.normal(1.0, 0.05, NUM_LIMBS), rng.uniform(0.5, 3.0, NUM_LIMBS)) for _ in range(count)
    ]
    proportions = LimbProportions(measured, SPREAD_M)
    alone = proportions.log_likelihood(proportions.information, proportions.pull).sum()
    together = proportions.log_likelihood(proportions.information.sum(0), proportions.pull.sum(0))

    difference_m = proportions.pull / proportions.information
    # The mean person is subtracted; the spread over people is 7 % of stature and 4 % of each limb.
    mean_m = (np.array([one.median_m for one in measured]) - difference_m)[0]
    over_people = np.outer(0.07 * mean_m, 0.07 * mean_m) + np.diag((0.04 * mean_m) ** 2)
    noise = [np.diag(1 / row) for row in proportions.information]
    blocks = [
        [over_people + (noise[a] if a == b else 0.0) for b in range(count)] for a in range(count)
    ]  # one person's measurements share the person's own lengths
    one = multivariate_normal(np.zeros(count * NUM_LIMBS), np.block(blocks)).logpdf(difference_m.ravel())
    many = sum(
        multivariate_normal(np.zeros(NUM_LIMBS), over_people + noise[k]).logpdf(difference_m[k]) for k in range(count)
    )
    np.testing.assert_allclose(together - alone, one - many, rtol=1e-6, atol=1e-6)


def test_change_of_body_is_found_at_its_frame() -> None:
    one, other = lengths_of(1, 110), lengths_of(4, 90)
    spread_m = spread_of_a_second_m([one, other], RATE_HZ)
    assert changes(np.concatenate([one, other]), spread_m, RATE_HZ) == [110]
    assert changes(np.concatenate([one, one]), spread_m, RATE_HZ) == []


def test_spread_follows_noise() -> None:
    rng = np.random.default_rng(0)
    lengths_m = 0.4 + rng.normal(0, 0.05, (2000, NUM_LIMBS, 2))
    found_m = spread_of_a_second_m([lengths_m], RATE_HZ)
    # The median of 50 values varies by 1.25 sigma over the root of 50.
    np.testing.assert_allclose(found_m, 1.25 * 0.05 / np.sqrt(50), rtol=0.5)
