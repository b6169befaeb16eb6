"""The global pass on tracks that were cut, doubled and exchanged."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from pipeline.association.tracking.observations import gather
from pipeline.core.data.cameras import Camera
from pipeline.core.data.people import Leftovers, Track3D
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.runtime import large_arrays
from pipeline.geometry.camera import project
from pipeline.run.engine.methods import Association
from pipeline.validation.simulation.motion.director import Cast
from pipeline.validation.simulation.scenes import find_scene, record
from tests.benchmarks.length import long_session
from tests.pipeline.association.identity.people import part, person, spliced, told_apart, walker

SHORT, TALL = 1, 4


def height_m(track: Track3D, rows: slice) -> float:
    """Mean height of the head's joints above the ankles."""
    return float(np.nanmean(track.xyz_m[rows, :5, 2]) - np.nanmean(track.xyz_m[rows, -2:, 2]))


def assert_one_build(track: Track3D, middle: int) -> None:
    assert height_m(track, slice(0, middle)) == pytest.approx(height_m(track, slice(middle, None)), abs=0.01)


def test_two_builds_differ() -> None:
    heights_m = [walker((0, 0), (0, 0), 2, build)[0, :5, 2].mean() for build in (SHORT, TALL)]
    assert abs(heights_m[0] - heights_m[1]) > 0.05


def test_whole_track_is_left_as_it_is(ring: tuple[Camera, ...]) -> None:
    track, seen = person(walker((-1, 0), (1, 0), 60, SHORT), ring)
    found = told_apart([(track, seen)], ring, 60)
    assert found.tracks[0].xyz_m is track.xyz_m
    assert found.observations[0].points_px is seen.points_px
    assert found.doubts == [[]]


def test_nobody_stays_nobody(ring: tuple[Camera, ...]) -> None:
    found = told_apart([], ring, 60)
    assert (tuple(found.tracks), tuple(found.observations), list(found.doubts)) == ((), (), [])


@pytest.mark.parametrize("gap", [1, 10, 40])
def test_person_who_was_lost_is_one_person(ring: tuple[Camera, ...], gap: int) -> None:
    whole = person(walker((-1, 0), (1, 0), 150, SHORT), ring)
    found = told_apart([part(whole, 0, 60), part(whole, 60 + gap, 150)], ring, 150)
    (track,) = found.tracks
    assert (track.start_frame, track.num_frames) == (0, 150)
    np.testing.assert_array_equal(track.xyz_m[100:], whole[0].xyz_m[100:])


def test_identity_after_another_door_is_kept_or_new(ring: tuple[Camera, ...]) -> None:
    first = person(walker((0, 0), (-2, 1), 100, SHORT), ring)
    again = person(walker((2, -1), (0, 0), 100, SHORT), ring, 300)
    other = person(walker((2, -1), (0, 0), 100, TALL), ring, 300)
    assert len(told_apart([first, again], ring, 400).tracks) == 1
    assert len(told_apart([first, other], ring, 400).tracks) == 2


def test_two_tracks_of_one_body_are_merged(ring: tuple[Camera, ...]) -> None:
    walk_m = walker((-1, 0), (1, 0), 80, SHORT)
    found = told_apart([person(walk_m, ring, seen_by=(0, 1)), person(walk_m, ring, seen_by=(2, 3))], ring, 80)
    (track,) = found.tracks
    assert (track.views == 4).all()
    assert np.linalg.norm(track.xyz_m - walk_m, axis=-1).max() < 0.03


def test_two_bodies_side_by_side_stay_two(ring: tuple[Camera, ...]) -> None:
    beside = [person(walker((-1, y), (1, y), 80, SHORT), ring) for y in (0.0, 0.3)]
    assert len(told_apart(beside, ring, 80).tracks) == 2


def test_people_who_were_exchanged_where_they_met_are_set_right(ring: tuple[Camera, ...]) -> None:
    one = person(walker((-2, 0.1), (2, 0.1), 200, SHORT), ring)
    other = person(walker((2, -0.1), (-2, -0.1), 200, TALL), ring)
    # Both turn back where they met: the tracks go on smoothly, with the wrong bodies.
    wrong = [spliced(part(one, 0, 100), part(other, 100, 200)), spliced(part(other, 0, 100), part(one, 100, 200))]
    found = told_apart(wrong, ring, 200)
    assert len(found.tracks) == 2
    for track in found.tracks:
        assert_one_build(track, 100)


def test_track_that_goes_over_to_newcomer_is_cut(ring: tuple[Camera, ...]) -> None:
    leaving = person(walker((0, 0), (1.5, 0), 100, SHORT), ring)
    entering = person(walker((1.5, 0), (0, 0), 100, TALL), ring, 100)
    found = told_apart([spliced(leaving, entering)], ring, 200)
    assert [(track.start_frame, track.num_frames) for track in found.tracks] == [(0, 100), (100, 100)]


def test_twins_who_meet_are_doubt(ring: tuple[Camera, ...]) -> None:
    # Both turn back where they meet; or do they pass each other?
    ways = [((-2, 0.1), (0, 0.1), (-2, 0.1)), ((2, -0.1), (0, -0.1), (2, -0.1))]
    tracks = [
        spliced(person(walker(a, b, 60, SHORT), ring), person(walker(b, c, 60, SHORT), ring, 60)) for a, b, c in ways
    ]
    found = told_apart(tracks, ring, 120)
    assert len(found.tracks) == 2
    for number, (doubts, other) in enumerate(zip(found.doubts, (2, 1), strict=True), start=1):
        (doubt,) = doubts
        assert doubt.frame == pytest.approx(60, abs=5)
        assert 0.5 <= doubt.confidence < 0.99
        assert doubt.other == other != number


def test_coincidence_of_two_cameras_is_left_out(ring: tuple[Camera, ...]) -> None:
    man = person(walker((-1, 0), (1, 0), 200, SHORT), ring)
    moment = person(walker((1, 1), (1, 1), 4, TALL), ring, 50, seen_by=(0, 1))
    while_long = person(walker((1, 1), (1, -1), 100, TALL), ring, 50, seen_by=(0, 1))
    everybody = person(walker((1, 1), (1, 1), 8, TALL), ring, 50)
    assert len(told_apart([man, moment], ring, 200).tracks) == 1
    assert len(told_apart([man, while_long], ring, 200).tracks) == 2
    assert len(told_apart([man, everybody], ring, 200).tracks) == 2


def test_chance_has_no_occasion_in_pauses(ring: tuple[Camera, ...]) -> None:
    """Two cameras see somebody for half a second; they take pictures for ten seconds, or for a whole day."""
    seen = person(walker((0, 0), (0.5, 0), 12, build=1), ring, start_frame=1000, seen_by=(0, 1))
    day = 24 * 3600 * 25
    assert len(told_apart([seen], ring, day).tracks) == 0
    assert len(told_apart([seen], ring, day, num_recorded=250).tracks) == 1


def test_bodies_of_nobody_fill_gap(ring: tuple[Camera, ...]) -> None:
    walk_m = walker((-1, 0), (1, 0), 150, SHORT)
    whole = person(walk_m, ring)
    frames, cameras = (grid.ravel() for grid in np.meshgrid(np.arange(60, 90), [1, 2], indexing="ij"))
    points_px = np.array([project(ring[k], walk_m[frame]) for frame, k in zip(frames, cameras, strict=True)])
    left = Leftovers(frames, cameras, points_px, np.full(points_px.shape[:2], 0.8))
    pieces = [part(whole, 0, 60), part(whole, 90, 150)]
    (track,) = told_apart(pieces, ring, 150, leftovers=left).tracks
    assert (track.views[60:90] == 2).all()
    assert np.linalg.norm(track.xyz_m[60:90] - walk_m[60:90], axis=-1).max() < 0.01
    far = Leftovers(frames, cameras, points_px + 200.0, left.score)
    (track,) = told_apart(pieces, ring, 150, leftovers=far).tracks
    assert np.isnan(track.xyz_m[62:88]).all()


def test_those_with_most_observations_stay(ring: tuple[Camera, ...]) -> None:
    brief = person(walker((-1, 1), (1, 1), 60, TALL), ring)
    long = person(walker((-1, -1), (1, -1), 100, SHORT), ring, 20)
    found = told_apart([brief, long], ring, 120, most=1)
    assert [(track.track_id, track.start_frame) for track in found.tracks] == [(1, 20)]
    assert len(found.doubts) == 1


@pytest.mark.slow
def test_memory_beside_large_arrays_grows_little(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(large_arrays, "MIN_BYTES", 50_000)
    monkeypatch.setattr(large_arrays, "MAX_HELD_BYTES", 0)
    clip = record(replace(find_scene("room"), cast=Cast(3, (3.0, 3.0)), duration_s=8.0), seed=4)
    lengths, peaks = (1_024, 2_560), []
    for num_frames in lengths:
        take = long_session(clip, num_frames)
        association = Association(take.cameras, take.times, take.timebase, take.joints, ReconstructionConfig())
        tracked = association.track(gather(take.cameras, take.times, take.detections))
        tracemalloc.start()
        people = association.assign_limbs(association.assign_identities(tracked))
        association.find_losses(association.follow_by_one_camera(people, tracked.leftovers))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    # Measured 1.0 to 2.1 KiB; 6.2 when states of limbs were made for all moments at once.
    assert np.diff(peaks)[0] / np.diff(lengths)[0] < 3_072
