"""Sides of limbs: somebody turns somersaults, and views call left right."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.association.identity.limbs import LimbPair, arms_and_legs
from pipeline.association.identity.merging import relocate
from pipeline.association.identity.sides import decide_sides
from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.joints import COCO_17
from pipeline.core.runtime import large_arrays
from pipeline.geometry.track_assembly import Person
from tests.pipeline.association.identity.people import RATE_HZ, person, walker

NUM_FRAMES = 75
TIMEBASE = Timebase(0.0, RATE_HZ, NUM_FRAMES)
_PAIRS = arms_and_legs(COCO_17)
assert _PAIRS is not None
ARMS, LEGS = _PAIRS


@pytest.fixture
def acrobat(ring: tuple[Camera, ...]) -> Person:
    """Somebody who turns a somersault a second, forwards, with legs astride and swinging arms."""
    xyz_m = walker((0.0, 0.0), (0.6, 0.3), NUM_FRAMES, 1)
    hips_m = xyz_m[:, [LEGS.left[0], LEGS.right[0]]].mean(1, keepdims=True)
    turn = Rotation.from_euler("y", np.linspace(0, 6 * np.pi, NUM_FRAMES)[:, None]).as_matrix()
    turned_m = np.einsum("fab,fjb->fja", turn, xyz_m - hips_m) + hips_m
    return person(turned_m + np.array([0.0, 0.0, 0.2]), ring)


def exchange(of: Person, where: np.ndarray, joints: Sequence[tuple[list[int], list[int]]]) -> Person:
    """Person whose labels are exchanged in some frames of some cameras, with the joints located from them."""
    track, seen = of
    points_px, score = seen.points_px.copy(), seen.score.copy()
    for both, other in joints:
        points_px[:, :, both] = np.where(where[..., None, None], points_px[:, :, other], points_px[:, :, both])
        score[:, :, both] = np.where(where[..., None], score[:, :, other], score[:, :, both])
    return replace(track), replace(seen, points_px=points_px, score=score)


def located(of: Person, ring: tuple[Camera, ...]) -> Person:
    """Person whose joints are located again in all frames."""
    return relocate(of, np.ones(NUM_FRAMES, bool), ring, TIMEBASE, 0.15)


def decided(of: Person, ring: tuple[Camera, ...]) -> Person:
    return decide_sides(of, ring, TIMEBASE, COCO_17, 0.15)


def wrong(of: Person, truth: Person) -> float:
    """Share of the observations that are not those of the truth."""
    same = np.isclose(of[1].points_px, truth[1].points_px, equal_nan=True).all((-1, -2))
    return float(1 - same.mean())


def test_nothing_changes_without_doubt(acrobat: Person, ring: tuple[Camera, ...]) -> None:
    assert decided(acrobat, ring) is acrobat


@pytest.mark.parametrize("limbs", [[ARMS], [LEGS], [ARMS, LEGS]], ids=["arms", "legs", "both"])
def test_views_that_call_left_right_are_exchanged(
    acrobat: Person, ring: tuple[Camera, ...], limbs: list[LimbPair]
) -> None:
    where = np.random.default_rng(3).random((NUM_FRAMES, len(ring))) < 0.25
    mixed = located(exchange(acrobat, where, [(pair.both, pair.exchanged) for pair in limbs]), ring)
    assert wrong(mixed, acrobat) > 0.2

    mended = decided(mixed, ring)

    assert wrong(mended, acrobat) < 0.01
    error_m = np.linalg.norm(mended[0].xyz_m - acrobat[0].xyz_m, axis=-1)
    assert np.nanmax(error_m) < 0.1


def test_sides_do_not_depend_on_blocks(
    acrobat: Person, ring: tuple[Camera, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    where = np.random.default_rng(3).random((NUM_FRAMES, len(ring))) < 0.25
    mixed = located(exchange(acrobat, where, [(ARMS.both, ARMS.exchanged)]), ring)
    whole = decided(mixed, ring)
    monkeypatch.setattr(large_arrays, "_BLOCK", 7)
    in_blocks = decided(mixed, ring)
    assert wrong(whole, mixed) > 0.2
    np.testing.assert_array_equal(in_blocks[1].points_px, whole[1].points_px)
    np.testing.assert_array_equal(in_blocks[0].xyz_m, whole[0].xyz_m)


def test_all_views_may_call_left_right_at_once(acrobat: Person, ring: tuple[Camera, ...]) -> None:
    where = np.zeros((NUM_FRAMES, len(ring)), bool)
    where[30:42] = True
    mixed = located(exchange(acrobat, where, [(LEGS.both, LEGS.exchanged)]), ring)

    assert wrong(decided(mixed, ring), acrobat) == 0


def test_view_that_is_alone_for_moment_follows_limbs(acrobat: Person, ring: tuple[Camera, ...]) -> None:
    track, seen = acrobat
    points_px, score = seen.points_px.copy(), seen.score.copy()
    points_px[40:44, 1:], score[40:44, 1:] = np.nan, 0.0
    alone = located((track, replace(seen, points_px=points_px, score=score)), ring)
    where = np.zeros((NUM_FRAMES, len(ring)), bool)
    where[38:44, 0] = True
    mixed = located(exchange(alone, where, [(pair.both, pair.exchanged) for pair in (ARMS, LEGS)]), ring)

    assert wrong(decided(mixed, ring), alone) < 0.005


def test_set_without_trunk_stays_as_it_is(acrobat: Person, ring: tuple[Camera, ...]) -> None:
    nameless = replace(COCO_17, names=tuple(f"point_{number}" for number in range(17)))
    assert decide_sides(acrobat, ring, TIMEBASE, nameless, 0.15) is acrobat
