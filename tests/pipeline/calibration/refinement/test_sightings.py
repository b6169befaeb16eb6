"""Choice of sightings."""

import numpy as np

from pipeline.calibration.refinement.sightings import choose_sightings, sampled_frames, sampled_poses
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Observations, People, Poses3D, Track3D
from pipeline.core.joints import COCO_17

TIMEBASE = Timebase(2.0, 50.0, 100_000)


def poses(frames: np.ndarray, xy_m: np.ndarray) -> Poses3D:
    num = len(frames)
    xyz_m = np.concatenate([np.broadcast_to(xy_m[:, None], (num, 17, 2)), np.ones((num, 17, 1))], axis=-1)
    # The frame is written into the pixels.
    points_px = np.broadcast_to(frames[:, None, None, None], (num, 17, 3, 2)).astype(float)
    return Poses3D(frames, xyz_m, points_px, np.full((num, 17, 3), 0.9))


def test_points_are_spread_over_floor_and_over_time() -> None:
    standing = poses(np.arange(0, 5000, 5), np.full((1000, 2), 0.2))
    walking = poses(np.arange(5000, 5100, 5), np.column_stack([np.arange(20) * 0.5 + 1.2, np.zeros(20)]))
    chosen = choose_sightings([standing, walking], COCO_17, TIMEBASE, max_points=17 * 40)
    times_s = np.unique(chosen.time_s)
    is_walking = times_s >= 2.0 + 5000 / 50
    assert is_walking.sum() == 20
    assert (~is_walking).sum() == 20
    assert np.diff(times_s[~is_walking]).max() < 6.0
    np.testing.assert_allclose(chosen.points_px[:, 0, 0], (chosen.time_s - 2.0) * 50)


def test_views_of_low_score_and_points_of_one_view_are_left_out() -> None:
    one = poses(np.array([0]), np.zeros((1, 2)))
    one.score[0, :, 0] = 0.1
    one.score[0, 5, 1] = 0.2
    chosen = choose_sightings([one], COCO_17, TIMEBASE)
    assert len(chosen) == 16
    assert np.isnan(chosen.points_px[:, 0]).all()
    assert np.isfinite(chosen.points_px[:, 1:]).all()


def test_nobody_gives_no_sightings() -> None:
    assert len(choose_sightings([], COCO_17, TIMEBASE)) == 0
    assert choose_sightings([poses(np.empty(0, int), np.empty((0, 2)))], COCO_17, TIMEBASE).points_px.shape == (0, 3, 2)


def test_poses_of_tracks_are_sampled_at_common_frames() -> None:
    shape = (23, 17)
    track = Track3D(
        1, 7, np.zeros((*shape, 3)), np.ones(shape), np.ones(shape, int), np.zeros(shape), np.ones(shape, int)
    )
    frame_of_row = np.arange(7, 30)
    points_px = np.broadcast_to(frame_of_row[:, None, None, None], (23, 3, 17, 2)).astype(float)
    people = People([track], [Observations(1, points_px, np.ones((23, 3, 17)))])
    (sampled,) = sampled_poses(people, TIMEBASE)
    assert sampled_frames(TIMEBASE).step == 5
    assert sampled.frame.tolist() == [10, 15, 20, 25]
    assert sampled.points_px.shape == (4, 17, 3, 2)
    assert (sampled.points_px[:, 0, 0, 0] == sampled.frame).all()
    # A short take has few frames: more of them count.
    assert sampled_frames(Timebase(0.0, 60.0, 100)).step == 2
