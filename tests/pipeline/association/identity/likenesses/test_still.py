"""Pictures of people, and people who hardly move."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from pipeline.association.identity.likenesses.still import StillPerson, find_still
from pipeline.core.data.people import Track3D
from pipeline.core.joints import COCO_17
from pipeline.validation.simulation.motion.script import Gesture, Stay
from tests.pipeline.association.identity.likenesses.scenes import RATE_HZ, Motion, moving, poster, track


def still(person: Track3D) -> StillPerson | None:
    return find_still(0, person, COCO_17, RATE_HZ)


@pytest.mark.parametrize("noise_m", [0.001, 0.01, 0.02])
def test_a_picture_never_moves(noise_m: float) -> None:
    found = still(track(poster(3), 1, noise_m))
    assert found is not None
    assert found.num_frames == 240
    assert found.moved_m < 1.5 * noise_m


def test_a_picture_that_somebody_hides_in_passing_never_moves() -> None:
    xyz_m = poster(4)
    xyz_m[60:75] = np.nan
    xyz_m[80:90, 5:11] = moving(0)[80:90, 5:11]
    found = still(track(xyz_m))
    assert found is not None
    assert found.num_frames == 225


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("gesture", [Gesture.IDLE, Gesture.TALK, Gesture.WAVE])
def test_people_at_one_place_move(seed: int, gesture: Gesture) -> None:
    assert still(track(moving(seed, cues=(Stay(8.0, gesture),)), seed)) is None


def sitting(seed: int) -> Motion:
    """Somebody who sits still: trunk and feet stay, the head sways by a centimetre and the hands move a little more."""
    rng = np.random.default_rng(seed)
    xyz_m = np.repeat(moving(seed, 1.0)[:1], 600, axis=0)
    for joints, sway_m in ((slice(0, 5), 0.01), (slice(9, 10), 0.02), (slice(10, 11), 0.02)):
        noise = gaussian_filter1d(rng.normal(size=(600, 3)), 30.0, axis=0)
        xyz_m[:, joints] += sway_m * (noise / noise.std(0))[:, None]
    return xyz_m


@pytest.mark.parametrize("seed", range(4))
def test_people_who_sit_still_move(seed: int) -> None:
    assert still(track(sitting(seed), seed)) is None


def test_somebody_who_stands_and_then_goes_moves() -> None:
    xyz_m = np.concatenate([np.repeat(moving(0)[:1], 400, axis=0), moving(0)[:60]])
    assert still(track(xyz_m)) is None


def test_a_hand_that_waves_fast_moves() -> None:
    xyz_m = poster(5)
    xyz_m[:, [7, 9]] += 0.2 * np.sin(2 * np.pi * 2.0 * np.arange(240) / RATE_HZ)[:, None, None]
    assert still(track(xyz_m)) is None


def test_little_is_not_enough() -> None:
    few_joints = poster(3)
    few_joints[:, 7:] = np.nan
    assert still(track(few_joints)) is None
    assert still(track(poster(3, 2.9))) is None
    assert still(track(poster(3), noise_m=0.05)) is None  # in such noise people would seem still
    assert still(track(np.full((240, 17, 3), np.nan))) is None
