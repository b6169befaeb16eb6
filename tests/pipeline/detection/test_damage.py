"""Pictures that are shown twice: found in moving scenes of several kinds, whatever the cut into ranges."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.detection.damage import ChangeMeter, doubled_frames, join_changes

NUM_FRAMES = 60
SIZE_PX = (96, 160)


def scene(person_px: int, noise: float, doubled: tuple[int, ...], coding: float = 0.3) -> list[np.ndarray]:
    """A square that walks in front of a wall; doubled pictures differ by the noise of the video's coding."""
    rng = np.random.default_rng(3)
    wall = rng.integers(40, 200, (*SIZE_PX, 3)).astype(float)
    pictures: list[np.ndarray] = []
    true = wall
    for number in range(NUM_FRAMES):
        if number not in doubled:
            true = wall + noise * rng.standard_normal(wall.shape)
            left = number * 2 % (SIZE_PX[1] - person_px)
            true[20 : 20 + person_px, left : left + person_px] = 250 - wall[20 : 20 + person_px, :person_px]
        shown = true + coding * rng.standard_normal(wall.shape)
        pictures.append(shown.clip(0, 255).round().astype(np.uint8))
    return pictures


def found(pictures: list[np.ndarray], start: int = 0) -> list[int]:
    meter = ChangeMeter()
    for number, picture in enumerate(pictures, start):
        meter.add(number, picture)
    numbers: list[int] = doubled_frames(meter.changes()).tolist()
    return numbers


@pytest.mark.parametrize("doubled", [(), (20,), (7, 8, 30, 59), tuple(range(1, 60, 2)), (1, 2, 4, 6, 7, 9, 11, 12, 14)])
def test_doubled_pictures_of_camera_with_noise_are_found(doubled: tuple[int, ...]) -> None:
    assert found(scene(40, 8.0, doubled)) == list(doubled)


def test_doubled_pictures_are_found_where_person_moves() -> None:
    assert found(scene(40, 0.0, (12, 33), coding=0.0)) == [12, 33]


def test_scene_that_stands_still_has_no_doubled_pictures() -> None:
    still = scene(40, 0.0, tuple(range(1, NUM_FRAMES)), coding=0.3)
    assert found(still) == []
    assert found([still[0]] * 10) == []
    # Somebody comes in after a second without a change.
    assert found([still[0]] * 25 + scene(40, 8.0, ())) == []


def test_frames_that_are_missing_are_no_comparison() -> None:
    pictures = scene(40, 8.0, ())
    meter = ChangeMeter()
    for number in (0, 1, 2, 5, 6):
        meter.add(number, pictures[number])
    assert np.isnan(meter.changes().change).tolist() == [True, False, False, True, False]


@pytest.mark.slow
@given(borders=st.lists(st.integers(0, NUM_FRAMES), max_size=5))
def test_ranges_are_joined_to_what_one_range_gives(borders: list[int]) -> None:
    pictures, parts = scene(40, 8.0, (10, 11, 40)), []
    for start, stop in pairwise([0, *sorted(borders), NUM_FRAMES]):
        meter = ChangeMeter()
        for number in range(start, stop):
            meter.add(number, pictures[number])
        parts.append(meter.changes())
    whole = ChangeMeter()
    for number, picture in enumerate(pictures):
        whole.add(number, picture)
    joined = join_changes(parts)
    np.testing.assert_array_equal(joined.change, whole.changes().change)
    np.testing.assert_array_equal(joined.frame, np.arange(NUM_FRAMES))
    assert doubled_frames(joined).tolist() == [10, 11, 40]
