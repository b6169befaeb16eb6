"""People who vanish in the middle of the room, and people who leave."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.association.identity.losses import find_losses
from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.people import PersonLoss, Track3D
from pipeline.geometry.camera import project
from tests.pipeline.association.identity.people import RATE_HZ, part, person, walker

NUM_FRAMES = 100
TIMEBASE = Timebase(2.0, RATE_HZ, NUM_FRAMES)
TIME_S = 2.0 + np.arange(NUM_FRAMES) / RATE_HZ
WALK_M = walker((-0.8, 0.4), (0.8, -0.4), NUM_FRAMES, 1)


def losses_of(
    ring: tuple[Camera, ...], *tracks: Track3D, timebase: Timebase = TIMEBASE, stop_s: float = np.inf
) -> list[PersonLoss]:
    times = {camera.name: FrameTimes(TIME_S[stop_s >= TIME_S]) for camera in ring}
    return find_losses(tracks, ring, times, timebase)


def seen_in(ring: tuple[Camera, ...], *frames: range) -> Track3D:
    """Track of the walk without the frames between the ranges."""
    track, _ = part(person(WALK_M, ring), frames[0].start, frames[-1].stop)
    is_seen = np.isin(np.array(track.frames), np.concatenate(frames))
    track.xyz_m[~is_seen] = np.nan
    return track


def test_loss_in_middle_has_frames_and_place(ring: tuple[Camera, ...]) -> None:
    (loss,) = losses_of(ring, seen_in(ring, range(10, 60)))
    assert (loss.kind, loss.track_id, loss.start_frame, loss.stop_frame) == ("vanished", 1, 60, NUM_FRAMES)
    np.testing.assert_allclose(loss.place_m, WALK_M[59].mean(0), atol=0.02)


def test_long_gap_is_loss_and_short_one_is_filled(ring: tuple[Camera, ...]) -> None:
    second = round(RATE_HZ)
    (loss,) = losses_of(ring, seen_in(ring, range(0, 30), range(30 + second + 2, NUM_FRAMES)))
    assert (loss.start_frame, loss.stop_frame) == (30, 30 + second + 2)
    assert losses_of(ring, seen_in(ring, range(0, 30), range(30 + second - 2, NUM_FRAMES))) == []


def test_last_moments_of_take_are_no_loss(ring: tuple[Camera, ...]) -> None:
    assert losses_of(ring, seen_in(ring, range(0, NUM_FRAMES - 10))) == []


def test_person_walking_out_is_not_lost(ring: tuple[Camera, ...]) -> None:
    far_m = walker((0.0, 0.0), (14.0, 0.0), NUM_FRAMES, 1)
    in_pictures = [
        [bool(((px >= 0) & (px < camera.size_px)).all()) for px in project(camera, far_m)] for camera in ring
    ]
    last = next(frame for frame in range(NUM_FRAMES) if np.sum(in_pictures, axis=0)[frame] < len(ring) / 2)
    track, _ = part(person(far_m, ring), 0, last)
    assert losses_of(ring, track) == []
    # A loss long before the border is found.
    assert [loss.start_frame for loss in losses_of(ring, part((track, person(far_m, ring)[1]), 0, 10)[0])] == [10]


def test_person_leaving_by_door_is_not_lost(ring: tuple[Camera, ...]) -> None:
    """The cameras of the ring see each other's places, and so the doors behind them."""
    wide = tuple(replace(camera, matrix=np.array([[350.0, 0, 639.5], [0, 350.0, 479.5], [0, 0, 1]])) for camera in ring)
    out_m = walker((0.0, 0.0), (3.2, 3.2), NUM_FRAMES, 1)
    track, seen = person(out_m, wide)
    leaves, _ = part((track, seen), 0, 75)
    assert np.linalg.norm(out_m[74].mean(0)[:2]) > 3.0
    assert losses_of(wide, leaves) == []
    assert [loss.start_frame for loss in losses_of(wide, part((track, seen), 0, 40)[0])] == [40]
    # A person who stands at the same place and is gone did not walk out.
    stands, _ = part(person(np.repeat(out_m[74:75], NUM_FRAMES, axis=0), wide), 0, 75)
    assert [loss.start_frame for loss in losses_of(wide, stands)] == [75]


def test_renumbered_person_is_not_lost(ring: tuple[Camera, ...]) -> None:
    first, second = seen_in(ring, range(0, 60)), seen_in(ring, range(64, NUM_FRAMES))
    assert losses_of(ring, first, second) == []
    elsewhere, _ = person(WALK_M + np.array([0.0, 0.8, 0.0]), ring)
    assert len(losses_of(ring, first, elsewhere)) == 1


def test_nobody_is_lost_where_no_camera_records(ring: tuple[Camera, ...]) -> None:
    assert losses_of(ring, seen_in(ring, range(0, 60)), stop_s=TIME_S[60]) == []


@pytest.mark.parametrize("rate_hz", [1.0, 5.0])
def test_frames_far_apart_tell_no_loss(ring: tuple[Camera, ...], rate_hz: float) -> None:
    timebase = Timebase(2.0, rate_hz, NUM_FRAMES)
    assert losses_of(ring, seen_in(ring, range(0, 20)), timebase=timebase) == []
