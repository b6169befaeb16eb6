"""People whom one camera alone still sees, before and behind the frames in which two cameras located them."""

import numpy as np
import pytest

from pipeline.association.identity.alone import follow_alone
from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.data.people import Leftovers, Source
from pipeline.core.joints import COCO_17
from pipeline.core.options.config import ReconstructionConfig
from pipeline.geometry.camera import project
from pipeline.geometry.track_assembly import Person
from pipeline.motion.skeleton.animate import animate
from tests.pipeline.association.identity.people import RATE_HZ, part, person, walker

NUM_FRAMES = 80
TIMEBASE = Timebase(0.0, RATE_HZ, NUM_FRAMES)
WALK_M = walker((-0.8, 0.4), (0.8, -0.4), NUM_FRAMES, 1)
BODY = slice(5, None)


def bodies_of(xyz_m: np.ndarray, frames: range, camera: int, ring: tuple[Camera, ...]) -> Leftovers:
    """Bodies of somebody in some frames of a camera."""
    points_px = project(ring[camera], xyz_m[frames.start : frames.stop])
    return Leftovers(np.array(frames), np.full(len(frames), camera), points_px, np.full(points_px.shape[:2], 0.9))


def joined(*some: Leftovers) -> Leftovers:
    frame, camera, points_px, score = (
        np.concatenate([getattr(bodies, name) for bodies in some]) for name in ("frame", "camera", "points_px", "score")
    )
    return Leftovers(frame, camera, points_px, score)


def followed(of: Person, left: Leftovers, ring: tuple[Camera, ...]) -> Person:
    (longer,) = follow_alone([of], left, ring, TIMEBASE, 0.15)
    return longer


@pytest.fixture
def middle(ring: tuple[Camera, ...]) -> Person:
    """Somebody whom all cameras see in the middle of a walk."""
    return part(person(WALK_M, ring), 20, 60)


def test_one_camera_continues_track_at_both_ends(middle: Person, ring: tuple[Camera, ...]) -> None:
    left = joined(bodies_of(WALK_M, range(8, 20), 2, ring), bodies_of(WALK_M, range(60, 72), 1, ring))

    track, seen = followed(middle, left, ring)

    assert (track.start_frame, track.num_frames) == (8, 64)
    added = np.r_[0:12, 52:64]
    assert (track.source[added] == Source.PREDICTED).all()
    assert (track.views[added] == 1).all()
    np.testing.assert_array_equal(np.flatnonzero((seen.score[-12:] > 0).any((0, 2))), [1])
    np.testing.assert_array_equal(track.xyz_m[12:52], middle[0].xyz_m)
    assert np.linalg.norm(track.xyz_m - WALK_M[8:72], axis=-1).max() < 0.15


def test_fit_keeps_distance_from_one_camera(middle: Person, ring: tuple[Camera, ...]) -> None:
    longer = followed(middle, bodies_of(WALK_M, range(60, 80), 1, ring), ring)
    (fitted,) = animate([longer[0]], [longer[1]], ring, TIMEBASE, COCO_17, ReconstructionConfig()).tracks
    assert fitted.num_frames == 60
    error_m = np.linalg.norm(fitted.xyz_m - WALK_M[20:80], axis=-1)[:, BODY]
    assert error_m[-20:].max() < 0.25
    assert fitted.uncertainty_m is not None
    assert np.nanmean(fitted.uncertainty_m[-5:, BODY]) > 2 * np.nanmean(fitted.uncertainty_m[20, BODY])


def test_second_is_longest(ring: tuple[Camera, ...]) -> None:
    track, _ = followed(part(person(WALK_M, ring), 0, 30), bodies_of(WALK_M, range(30, 80), 0, ring), ring)
    assert track.num_frames == 30 + RATE_HZ


def test_pause_ends_track(middle: Person, ring: tuple[Camera, ...]) -> None:
    left = joined(bodies_of(WALK_M, range(60, 64), 1, ring), bodies_of(WALK_M, range(72, 80), 1, ring))
    assert followed(middle, left, ring)[0].num_frames == 44


def test_bodies_elsewhere_are_nobody(middle: Person, ring: tuple[Camera, ...]) -> None:
    aside_m = WALK_M + np.array([0.0, 0.8, 0.0])
    assert followed(middle, bodies_of(aside_m, range(60, 70), 1, ring), ring) is middle


def test_second_detection_of_neighbour_is_neighbours(middle: Person, ring: tuple[Camera, ...]) -> None:
    near_m = WALK_M + np.array([0.0, 0.05, 0.0])
    left = bodies_of(near_m, range(60, 70), 1, ring)
    neighbour = part(person(near_m, ring), 58, 80)
    assert follow_alone([middle, neighbour], left, ring, TIMEBASE, 0.15) == [middle, neighbour]


def test_two_people_get_their_own_bodies(ring: tuple[Camera, ...]) -> None:
    other_m = walker((0.8, 1.2), (-0.8, 1.0), NUM_FRAMES, 4)
    people = [part(person(xyz_m, ring), 0, 60) for xyz_m in (WALK_M, other_m)]
    left = joined(*(bodies_of(xyz_m, range(60, 75), 3, ring) for xyz_m in (other_m, WALK_M)))
    for (track, _), xyz_m in zip(follow_alone(people, left, ring, TIMEBASE, 0.15), (WALK_M, other_m), strict=True):
        assert track.num_frames == 75
        assert np.linalg.norm(track.xyz_m - xyz_m[:75], axis=-1).max() < 0.15
