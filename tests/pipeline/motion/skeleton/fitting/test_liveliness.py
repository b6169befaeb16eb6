"""Liveliness of people: accelerations beyond usual ones are told from the noise of the detector, at their instant."""

import numpy as np
import pytest

from pipeline.core.data.cameras import Timebase
from pipeline.core.joints import COCO_17
from pipeline.motion.skeleton.fitting.liveliness import liveliness
from pipeline.motion.skeleton.fitting.positions import usual_step_m
from pipeline.motion.skeleton.fitting.rays import Rays
from tests.pipeline.conftest import body
from tests.pipeline.motion.skeleton.observed import observe, ring_of

CAMERAS = ring_of(5)
NUM_FRAMES = 240


def seen_liveliness(
    truth_m: np.ndarray, noise_px: float, rate_hz: float, unseen: np.ndarray | None = None
) -> np.ndarray:
    track, seen = observe(CAMERAS, truth_m, noise_px, unseen, seed=4)
    usual_m = usual_step_m(COCO_17, Timebase(0.0, rate_hz, len(truth_m)))

    def rays_of(rows: slice) -> Rays:
        return Rays(CAMERAS, seen.points_px[rows], seen.score[rows], COCO_17)

    return liveliness(track, rays_of, usual_m, COCO_17, rate_hz)


def shaken(ratio: np.ndarray, rate_hz: float) -> np.ndarray:
    """Body whose joints have independent random accelerations, ``ratio`` times the usual ones in each frame.

    A weak spring keeps the joints near their places.
    """
    usual_m = usual_step_m(COCO_17, Timebase(0.0, rate_hz, len(ratio)))
    drawn = np.random.default_rng(9).normal(size=(len(ratio), 17, 3)) / np.sqrt(3)
    step_m = ratio[:, None, None] * usual_m[:, None] * drawn
    off_m, speed_m = np.zeros((len(ratio), 17, 3)), np.zeros((17, 3))
    for frame in range(1, len(ratio)):
        speed_m = 0.97 * speed_m - 0.001 * off_m[frame - 1] + step_m[frame]
        off_m[frame] = off_m[frame - 1] + speed_m
    return body() + off_m


@pytest.mark.parametrize(("rate_hz", "noise_px"), [(60.0, 2.5), (25.0, 6.0), (120.0, 1.0)])
def test_noise_alone_is_not_lively(rate_hz: float, noise_px: float) -> None:
    still_m = np.repeat(body()[None], NUM_FRAMES, axis=0)
    np.testing.assert_array_equal(seen_liveliness(still_m, noise_px, rate_hz), 1.0)
    usual_m = shaken(np.full(NUM_FRAMES, 0.7), rate_hz)
    assert seen_liveliness(usual_m, noise_px, rate_hz).max() < 1.3


@pytest.mark.parametrize("rate_hz", [30.0, 60.0])
@pytest.mark.parametrize("ratio", [3.0, 6.0])
def test_liveliness_is_measured_in_its_span(rate_hz: float, ratio: float) -> None:
    true = np.where(np.abs(np.arange(NUM_FRAMES) - NUM_FRAMES / 2) < rate_hz, ratio, 0.5)
    found = seen_liveliness(shaken(true, rate_hz), 2.5, rate_hz)
    middle = slice(NUM_FRAMES // 2 - round(0.6 * rate_hz), NUM_FRAMES // 2 + round(0.6 * rate_hz))
    # A lower bound by two standard errors of spans of half a second.
    assert 0.6 * ratio < np.median(found[middle]) < 1.1 * ratio
    is_far = np.abs(np.arange(NUM_FRAMES) - NUM_FRAMES / 2) > 1.7 * rate_hz
    np.testing.assert_array_equal(found[is_far], 1.0)


def test_few_observations_tell_nothing() -> None:
    moved_m = shaken(np.full(NUM_FRAMES, 6.0), 30.0)
    unseen = np.zeros((NUM_FRAMES, len(CAMERAS), 17), dtype=bool)
    # One view sees no depth; a joint alone has too few differences.
    unseen[:, 1:] = True
    np.testing.assert_array_equal(seen_liveliness(moved_m, 1.0, 30.0, unseen), 1.0)
    unseen[:, 1:, COCO_17.index("left_wrist")] = False
    np.testing.assert_array_equal(seen_liveliness(moved_m, 1.0, 30.0, unseen), 1.0)
    np.testing.assert_array_equal(seen_liveliness(moved_m[:2], 1.0, 30.0), 1.0)
