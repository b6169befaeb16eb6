"""Heels and toes that are held: places keep the foot's length, and each part has its own contacts."""

import numpy as np

from pipeline.core.data.animation import FootContact, FootPart
from pipeline.motion.skeleton.feet.holding import held_parts_m
from tests.pipeline.motion.skeleton.feet.gait import RATE_HZ, gait

NUM_FRAMES = 60


def parts_m() -> np.ndarray:
    """Left and right heel and toe of a walk, (frames, feet, parts, 3), with noise."""
    true_m = gait(NUM_FRAMES).xyz_m[:, 17:].reshape(NUM_FRAMES, 2, 2, 3).swapaxes(1, 2)
    return np.asarray(true_m + np.random.default_rng(1).normal(0.0, 0.005, true_m.shape))


def contact(part: FootPart, start: int, num_frames: int, *, pinned: bool = True) -> FootContact:
    return FootContact("left", start, num_frames, 0.9, pinned, 0.01, 0.01, part)


def length_m(points_m: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.norm(points_m[:, 0, 1, :2] - points_m[:, 0, 0, :2], axis=-1))


def test_flat_foot_keeps_its_length_and_hardly_moves() -> None:
    places_m = held_parts_m(parts_m(), [contact("heel", 34, 12), contact("toe", 37, 16)], RATE_HZ)
    flat = slice(37, 46)
    np.testing.assert_allclose(length_m(places_m)[flat], length_m(parts_m())[flat], atol=1e-12)
    moved_m = np.ptp(places_m[flat, 0, :, :2], axis=0)
    assert moved_m.max() < np.ptp(parts_m()[flat, 0, :, :2], axis=0).max()


def test_part_that_stands_alone_stands_still() -> None:
    places_m = held_parts_m(parts_m(), [contact("toe", 37, 16)], RATE_HZ)
    np.testing.assert_allclose(np.ptp(places_m[37:53, 0, 1, :2], axis=0), 0.0, atol=1e-12)
    assert np.isnan(places_m[:, 0, 0]).all()  # the heel is free
    assert np.isnan(places_m[:, 1]).all()  # and so is the other foot
    assert np.isnan(places_m[..., 2]).all()


def test_contacts_unpinned_or_of_whole_feet_hold_no_part() -> None:
    free = [contact("heel", 34, 12, pinned=False), contact("foot", 34, 12)]
    assert np.isnan(held_parts_m(parts_m(), free, RATE_HZ)).all()
