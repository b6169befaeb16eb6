"""Expected places of people who lie, stand, and are out of sight for a while."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest

from pipeline.association.redetection.expect import ExpectedBodies, expect_bodies, expected_body_m
from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.people import Observations, Source, Track3D
from pipeline.core.joints import BODY_FEET, COCO_17, other_side
from pipeline.geometry.camera import project
from pipeline.geometry.track_assembly import Person
from tests.pipeline.association.identity.people import RATE_HZ, person, walker

NUM_FRAMES = 50
TIMEBASE = Timebase(10.0, RATE_HZ, NUM_FRAMES)


def lying_m() -> np.ndarray:
    """Somebody who lies on the floor, with the head towards X."""
    x, y, z = np.moveaxis(walker((0.0, 0.0), (0.0, 0.0), NUM_FRAMES, 1), -1, 0)
    return np.stack([z - 1.0, y, 0.3 - x], axis=-1)


def missed(track: Track3D, ring: tuple[Camera, ...]) -> Observations:
    """Observations of a person whom detectors missed in all pictures."""
    shape = track.num_frames, len(ring), track.xyz_m.shape[1]
    return Observations(track.track_id, np.full((*shape, 2), np.nan), np.zeros(shape))


def expected(
    track: Track3D,
    ring: tuple[Camera, ...],
    rate_hz: float = RATE_HZ,
    seen: Observations | None = None,
    turns_deg: Mapping[str, float] = MappingProxyType({}),
    others: Sequence[Person] = (),
) -> list[ExpectedBodies]:
    """Expected bodies of a track, in cameras that take pictures at a rate; missed in all pictures by default."""
    time_s = 10.0 + np.arange(round(NUM_FRAMES * rate_hz / RATE_HZ)) / rate_hz
    times = {camera.name: FrameTimes(time_s) for camera in ring}
    turns = {camera.name: turns_deg.get(camera.name, 0.0) for camera in ring}
    people = [(track, missed(track, ring) if seen is None else seen), *others]
    return list(expect_bodies(people, ring, times, TIMEBASE, COCO_17, turns))


def test_standing_person_is_not_expected(ring: tuple[Camera, ...]) -> None:
    track, _ = person(walker((-1.0, 0.0), (1.0, 0.0), NUM_FRAMES, 1), ring)
    assert [len(bodies.frame) for bodies in expected(track, ring)] == [0] * len(ring)


def test_lying_person_is_expected_in_place(ring: tuple[Camera, ...]) -> None:
    xyz_m = lying_m()
    track, _ = person(xyz_m, ring)
    found = expected(track, ring)
    assert [bodies.camera for bodies in found] == [camera.name for camera in ring]
    # The camera behind the feet sees the body upright.
    assert sorted(len(bodies.frame) for bodies in found)[1:] == [NUM_FRAMES] * (len(ring) - 1)
    for camera, bodies in zip(ring, found, strict=True):
        places_px = project(camera, xyz_m)[bodies.frame]
        assert np.linalg.norm(bodies.keypoints_px - places_px, axis=-1).max(initial=0.0) < 5.0
        assert bodies.is_wanted.all()


def test_agreeing_detection_expects_no_body(ring: tuple[Camera, ...]) -> None:
    track, seen = person(lying_m(), ring)
    assert [len(bodies.frame) for bodies in expected(track, ring, seen=seen)] == [0] * len(ring)
    # In frames 3 to 6 of the first camera three joints are at other places, in frames 7 to 10 two.
    points_px = seen.points_px.copy()
    for joint in BODY_FEET.indices(("left_ankle", "left_knee")):
        points_px[3:11, 0, joint] += 200.0
    points_px[3:7, 0, BODY_FEET.index("right_wrist")] += 200.0
    found = expected(track, ring, seen=replace(seen, points_px=points_px))
    assert [bodies.frame.tolist() for bodies in found] == [[3, 4, 5, 6], *([] for _ in ring[1:])]


def test_wrong_arm_of_close_people_is_looked_at_again(ring: tuple[Camera, ...]) -> None:
    """Of two who stand half a metre apart one has an arm elsewhere in the first camera: the other is painted out."""
    track, seen = person(walker((0.0, 0.0), (0.3, 0.0), NUM_FRAMES, 1), ring)
    near = person(walker((0.0, 0.5), (0.3, 0.5), NUM_FRAMES, 2), ring)
    assert [len(bodies.frame) for bodies in expected(track, ring, seen=seen, others=[near])] == [0] * len(ring)
    points_px = seen.points_px.copy()
    for joint in COCO_17.indices(("left_shoulder", "left_elbow", "left_wrist")):
        points_px[3:7, 0, joint] += 200.0
    wrong = replace(seen, points_px=points_px)
    first, *rest = expected(track, ring, seen=wrong, others=[near])
    assert first.frame.tolist() == [3, 3, 4, 4, 5, 5, 6, 6]
    assert first.is_wanted.tolist() == [True, False] * 4
    assert [len(bodies.frame) for bodies in rest] == [0] * len(rest)
    far = person(walker((0.0, 9.0), (0.3, 9.0), NUM_FRAMES, 2), ring)
    assert [len(bodies.frame) for bodies in expected(track, ring, seen=wrong, others=[far])] == [0] * len(ring)


def test_swapped_sides_expect_body(ring: tuple[Camera, ...]) -> None:
    track, seen = person(lying_m(), ring)
    sides = COCO_17.indices(tuple(map(other_side, COCO_17.names)))
    found = expected(track, ring, seen=replace(seen, points_px=seen.points_px[:, :, sides]))
    assert sum(len(bodies.frame) for bodies in found) > NUM_FRAMES


def test_picture_that_is_turned_upright_shows_another_lean(ring: tuple[Camera, ...]) -> None:
    track, _ = person(lying_m(), ring)
    upright = next(camera for camera, bodies in zip(ring, expected(track, ring), strict=True) if not len(bodies.frame))
    turned = dict(
        zip((camera.name for camera in ring), expected(track, ring, turns_deg={upright.name: 180.0}), strict=True)
    )
    assert len(turned[upright.name].frame) == NUM_FRAMES


def test_pictures_between_output_frames_have_places_between(ring: tuple[Camera, ...]) -> None:
    xyz_m = lying_m() + np.linspace(0.0, 0.5, NUM_FRAMES)[:, None, None] * (0.0, 1.0, 0.0)
    track, _ = person(xyz_m, ring)
    for camera, bodies in zip(ring, expected(track, ring, 2 * RATE_HZ), strict=True):
        rows = np.flatnonzero((bodies.frame % 2 == 1) & (bodies.frame > 10) & (bodies.frame < 90))
        between_m = (xyz_m[bodies.frame[rows] // 2] + xyz_m[bodies.frame[rows] // 2 + 1]) / 2
        apart_px = np.linalg.norm(bodies.keypoints_px[rows] - project(camera, between_m), axis=-1)
        assert apart_px.max(initial=0.0) < 5.0


@pytest.mark.parametrize(("gap", "is_expected"), [(20, True), (34, False)])
def test_joint_is_expected_between_its_neighbours_in_time(
    ring: tuple[Camera, ...], gap: int, is_expected: bool
) -> None:
    track, _ = person(lying_m(), ring)
    gone = slice(8, 8 + gap)
    track.source[gone], track.xyz_m[gone] = Source.ABSENT, np.nan
    body_m = expected_body_m(track, COCO_17, RATE_HZ)
    assert np.isfinite(body_m[8 + gap // 2]).all() == is_expected
    assert np.isfinite(body_m[[7, 8 + gap]]).all()


def test_feet_are_no_part_of_expected_body(ring: tuple[Camera, ...]) -> None:
    xyz_m = lying_m()
    track, _ = person(np.concatenate([xyz_m, xyz_m[:, -4:] + 9.0], axis=1), ring)
    assert expected_body_m(track, BODY_FEET, RATE_HZ).shape == (NUM_FRAMES, 17, 3)
