"""Phantoms: tracks that go on with the limbs of other people, and people who are hardly seen."""

import numpy as np
import pytest

from pipeline.association.identity.phantoms import end_phantoms
from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.data.people import PersonLoss, Source
from pipeline.core.joints import COCO_17
from pipeline.geometry.track_assembly import Person
from tests.pipeline.association.identity.people import RATE_HZ, person, told_apart, walker

NUM_FRAMES = 100
TIMEBASE = Timebase(0.0, RATE_HZ, NUM_FRAMES)
NEIGHBOUR_M = walker((0.4, -0.5), (0.4, 0.5), NUM_FRAMES, 1)
WALK_M = walker((-0.4, 0.5), (-0.4, -0.5), NUM_FRAMES, 2)
ARMS = COCO_17.indices(("left_elbow", "right_elbow", "left_wrist", "right_wrist"))


def hardly_seen(xyz_m: np.ndarray, frames: slice, ring: tuple[Camera, ...]) -> Person:
    """Person whose arms alone are seen in some frames, by two cameras."""
    track, seen = person(xyz_m, ring)
    is_seen = np.ones(seen.score.shape, bool)
    is_seen[frames] = False
    is_seen[frames, :2, ARMS[0] : ARMS[-1] + 1] = True
    seen.points_px[~is_seen], seen.score[~is_seen] = np.nan, 0.0
    is_located = is_seen.sum(1) >= 2
    track.xyz_m[~is_located], track.source[~is_located] = np.nan, Source.ABSENT
    return track, seen


@pytest.mark.parametrize("sides", ["same", "exchanged"])
def test_track_that_goes_on_with_neighbour_s_arms_ends(ring: tuple[Camera, ...], sides: str) -> None:
    limbs_m = WALK_M.copy()
    arms = ARMS
    if sides == "exchanged":
        arms = [arm + (1 if COCO_17.names[arm].startswith("left") else -1) for arm in ARMS]
    limbs_m[55:, ARMS] = NEIGHBOUR_M[55:, arms] + np.array([0.03, 0.0, 0.02])
    neighbour, phantom = person(NEIGHBOUR_M, ring), hardly_seen(limbs_m, slice(55, None), ring)
    (kept, none), (ended, losses) = end_phantoms([neighbour, phantom], ring, COCO_17, TIMEBASE, 0.1)
    assert none == []
    assert kept is neighbour
    assert ended is not None
    # Windows of half a second blur the moment at which the person is gone.
    assert ended[0].frames.stop == pytest.approx(55, abs=7)
    (loss,) = losses
    assert (loss.kind, loss.stop_frame) == ("phantom", NUM_FRAMES)
    assert loss.start_frame == pytest.approx(55, abs=7)
    arms_m = NEIGHBOUR_M[60:, ARMS].mean((0, 1))
    np.testing.assert_allclose(loss.place_m, arms_m, atol=0.15)
    np.testing.assert_array_equal(ended[1].score[:45], phantom[1].score[:45])


def test_somebody_whose_own_arms_alone_are_seen_is_no_phantom(ring: tuple[Camera, ...]) -> None:
    hidden = hardly_seen(WALK_M, slice(55, None), ring)
    persons = [person(NEIGHBOUR_M, ring), hidden]
    assert [(kept is one, losses) for one, (kept, losses) in zip(persons, _ended(persons, ring), strict=True)] == [
        (True, []),
        (True, []),
    ]


def test_person_with_neighbour_s_arms_is_no_phantom(ring: tuple[Camera, ...]) -> None:
    """All other joints are the person's own: a hug."""
    limbs_m = WALK_M.copy()
    limbs_m[55:, ARMS] = NEIGHBOUR_M[55:, ARMS]
    persons = [person(NEIGHBOUR_M, ring), person(limbs_m, ring)]
    assert all(not losses for _, losses in _ended(persons, ring))


def test_neighbour_of_phantom_stays_however_badly_seen(ring: tuple[Camera, ...]) -> None:
    """Both have the same limbs; the one with more observations is the person."""
    neighbour = hardly_seen(NEIGHBOUR_M, slice(0, NUM_FRAMES), ring)
    fewer = hardly_seen(NEIGHBOUR_M, slice(0, NUM_FRAMES), ring)
    fewer[1].score[:, :, ARMS[-1]] = 0.0
    fewer[1].points_px[:, :, ARMS[-1]] = np.nan
    (kept, losses), (gone, phantoms) = _ended([neighbour, fewer], ring)
    assert (kept is neighbour, losses) == (True, [])
    assert gone is None
    assert [(loss.start_frame, loss.stop_frame) for loss in phantoms] == [(0, NUM_FRAMES)]


def test_people_after_phantom_keep_their_numbers_in_order(ring: tuple[Camera, ...]) -> None:
    """The global pass drops the phantom, and says of which person it was."""
    walk_m = walker((0.1, 0.5), (0.1, -0.5), NUM_FRAMES, 2)
    limbs_m = walk_m.copy()
    limbs_m[50:, ARMS] = NEIGHBOUR_M[50:, ARMS]
    people = told_apart([hardly_seen(limbs_m, slice(50, None), ring), person(NEIGHBOUR_M, ring)], ring, NUM_FRAMES)
    (loss,) = people.losses
    track = people.tracks[loss.track_id - 1]
    assert (track.track_id, track.frames.stop) == (loss.track_id, loss.start_frame)
    assert loss.start_frame == pytest.approx(50, abs=7)
    assert np.linalg.norm(track.xyz_m[10].mean(0) - walk_m[10].mean(0)) < 0.1


def _ended(persons: list[Person], ring: tuple[Camera, ...]) -> list[tuple[Person | None, list[PersonLoss]]]:
    return end_phantoms(persons, ring, COCO_17, TIMEBASE, 0.1)
