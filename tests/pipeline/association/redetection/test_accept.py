"""Bodies that were detected again, and the observations of their tracks."""

from dataclasses import replace

import numpy as np

from pipeline.association.redetection.accept import accept
from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.detections import Detections
from pipeline.core.data.people import People
from pipeline.core.joints import COCO_17, other_side
from pipeline.geometry.camera import project
from pipeline.geometry.track_assembly import Person
from tests.pipeline.association.identity.people import RATE_HZ, person, walker

NUM_FRAMES = 40
TIMEBASE = Timebase(0.0, RATE_HZ, NUM_FRAMES)
GONE = slice(10, 20)
SCORE = 0.7


def unseen(of: Person, camera: int) -> Person:
    """Person whom a camera does not see for a while."""
    track, seen = of
    points_px, score = seen.points_px.copy(), seen.score.copy()
    points_px[GONE, camera], score[GONE, camera] = np.nan, 0.0
    detection = np.arange(NUM_FRAMES * seen.score.shape[1], dtype=np.int32).reshape(NUM_FRAMES, -1)
    return track, replace(seen, points_px=points_px, score=score, detection=detection)


def found_in(ring: tuple[Camera, ...], camera: int, xyz_m: np.ndarray) -> dict[str, Detections]:
    """Bodies at places in the frames in which the camera sees nobody; none in the other cameras."""
    frames = np.arange(GONE.start, GONE.stop)
    of_nobody = np.full((10, 4), np.nan)
    found = {}
    for number, one in enumerate(ring):
        bodies = Detections(one.name, frames, project(one, xyz_m[frames]), np.full((10, 17), SCORE), of_nobody)
        found[one.name] = bodies if number == camera else bodies.within(range(0))
    return found


def accepted(persons: list[Person], found: dict[str, Detections], ring: tuple[Camera, ...]) -> People:
    times = {camera.name: FrameTimes(np.arange(NUM_FRAMES) / RATE_HZ) for camera in ring}
    tracks = tuple(replace(track, track_id=number) for number, (track, _) in enumerate(persons, start=1))
    observations = tuple(replace(seen, track_id=number) for number, (_, seen) in enumerate(persons, start=1))
    return accept(People(tracks, observations), found, ring, times, TIMEBASE, COCO_17, 0.15, 10.0)


def test_body_where_it_is_expected_is_persons(ring: tuple[Camera, ...]) -> None:
    xyz_m = walker((-0.5, 0.0), (0.5, 0.0), NUM_FRAMES, 1)
    whole = person(xyz_m, ring)
    people = accepted([unseen(whole, 2)], found_in(ring, 2, xyz_m), ring)
    (seen,), (track,) = people.observations, people.tracks
    np.testing.assert_allclose(seen.points_px[GONE, 2], project(ring[2], xyz_m[GONE]))
    assert (seen.score[GONE, 2] == SCORE).all()
    assert (track.views[GONE] == len(ring)).all()
    np.testing.assert_array_equal(seen.points_px[GONE.stop :], whole[1].points_px[GONE.stop :])
    # Colours of clothes are found by these rows.
    assert seen.detection.shape == (NUM_FRAMES, len(ring))


def test_sides_of_body_do_not_matter(ring: tuple[Camera, ...]) -> None:
    xyz_m = walker((-0.5, 0.0), (0.5, 0.0), NUM_FRAMES, 1)
    exchanged = COCO_17.indices(tuple(map(other_side, COCO_17.names)))
    people = accepted([unseen(person(xyz_m, ring), 2)], found_in(ring, 2, xyz_m[:, exchanged]), ring)
    assert (people.observations[0].score[GONE, 2] > 0).all()


def test_body_far_from_its_place_is_nobodys(ring: tuple[Camera, ...]) -> None:
    xyz_m = walker((-0.5, 0.0), (0.5, 0.0), NUM_FRAMES, 1)
    lost = unseen(person(xyz_m, ring), 2)
    people = accepted([lost], found_in(ring, 2, xyz_m + np.array([0.0, 0.0, 0.6])), ring)
    assert (people.observations[0].score[GONE, 2] == 0).all()


def test_person_in_front_is_not_hidden_one(ring: tuple[Camera, ...]) -> None:
    hidden_m = walker((-0.5, 0.0), (0.5, 0.0), NUM_FRAMES, 1)
    front_m = hidden_m + np.array([0.0, 0.25, 0.0])
    hidden, front = unseen(person(hidden_m, ring), 1), unseen(person(front_m, ring), 1)
    people = accepted([hidden, front], found_in(ring, 1, front_m), ring)
    assert (people.observations[0].score[GONE, 1] == 0).all()
    assert (people.observations[1].score[GONE, 1] == SCORE).all()


def test_joints_that_are_not_read_again_stay(ring: tuple[Camera, ...]) -> None:
    xyz_m = walker((-0.5, 0.0), (0.5, 0.0), NUM_FRAMES, 1)
    whole = person(xyz_m, ring)
    whole[1].points_px[GONE, 2] += 60.0  # wrong marks
    found = found_in(ring, 2, xyz_m)
    wrist = COCO_17.index("left_wrist")
    for values, missing in ((found[ring[2].name].keypoints_px, np.nan), (found[ring[2].name].score, 0.0)):
        values[:, wrist] = missing
    (seen,) = accepted([whole], found, ring).observations
    np.testing.assert_array_equal(seen.points_px[GONE, 2, wrist], whole[1].points_px[GONE, 2, wrist])
    assert (np.delete(seen.score[GONE, 2], wrist, axis=1) == SCORE).all()


def test_joints_that_both_detections_mark_alike_stay(ring: tuple[Camera, ...]) -> None:
    xyz_m = walker((-0.5, 0.0), (0.5, 0.0), NUM_FRAMES, 1)
    whole, found = person(xyz_m, ring), found_in(ring, 2, xyz_m + 0.01)
    (seen,) = accepted([whole], found, ring).observations
    np.testing.assert_array_equal(seen.points_px, whole[1].points_px)


def test_without_bodies_people_stay_as_they_are(ring: tuple[Camera, ...]) -> None:
    whole = person(walker((-0.5, 0.0), (0.5, 0.0), NUM_FRAMES, 1), ring)
    none = {name: bodies.within(range(0)) for name, bodies in found_in(ring, 0, whole[0].xyz_m).items()}
    people = accepted([whole], none, ring)
    assert people.observations[0].points_px is whole[1].points_px
    assert people.tracks[0].xyz_m is whole[0].xyz_m
