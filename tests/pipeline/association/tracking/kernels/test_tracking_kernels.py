"""Compiled tracking loops, compared with the reference in NumPy."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from pipeline.association.tracking.initialization import epipolar_affinity
from pipeline.association.tracking.kernels import observation_kernels
from pipeline.association.tracking.kernels import tracking_kernels as kernels
from pipeline.association.tracking.kernels.assignment_kernels import assign
from pipeline.association.tracking.kernels.state import make_workspace
from pipeline.association.tracking.observations import gather, undistorted
from pipeline.association.tracking.track_people import reconstruct_tracks
from pipeline.association.tracking.tracker import Tracker, make_frames, make_rig
from pipeline.association.tracking.tracking_parameters import derive_parameters
from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import image_from_world
from pipeline.geometry.tracks import triangulate_frames
from pipeline.geometry.triangulation import triangulate_robust
from pipeline.run.warm_up import warm_up
from pipeline.validation.simulation.scenes import SCENES, record
from tests.cases import slow_but
from tests.pipeline.association.tracking import reference


@pytest.mark.parametrize(
    ("scene", "seed"),
    slow_but([("comings-and-goings", 2)], [("noisy", 3), ("unsynchronised", 1), ("comings-and-goings", 2)]),
)
def test_tracks_are_those_of_reference(scene: str, seed: int) -> None:
    simulation = record(replace(SCENES[scene], duration_s=8.0), seed)
    parameters = derive_parameters(simulation.cameras, simulation.timebase.frame_rate_hz)
    bodies = gather(simulation.cameras, simulation.times, simulation.detections)
    times, ideal_px = (
        [simulation.times[camera.name] for camera in simulation.cameras],
        undistorted(simulation.cameras, bodies),
    )
    frames = make_frames(times, bodies, ideal_px, parameters.min_score)
    plain = reference.ReferenceTracker(simulation.cameras, make_rig(simulation.cameras), frames, parameters)
    identity = plain.run()
    tracker = Tracker(simulation.cameras, frames, parameters)
    np.testing.assert_array_equal(tracker.run(), identity)
    assert len(np.unique(identity[identity >= 0])) >= len(simulation.truth_m) // 2
    state = tracker.state.states()
    assert [target.target_id for target in plain.targets] == state["target_id"].tolist()
    num_joints = bodies.score.shape[1]
    for target, found in zip(plain.targets, state, strict=True):
        np.testing.assert_allclose(found["xyz_m"][:, :num_joints].T, target.xyz_m, atol=1e-9)
        np.testing.assert_allclose(found["velocity_m_s"][:, :num_joints].T, target.velocity_m_s, atol=1e-7)


def test_triangulation_over_time_is_that_of_reference(ring: tuple[Camera, ...]) -> None:
    rng = np.random.default_rng(5)
    projections = np.array([image_from_world(camera) for camera in ring])
    truth_m = np.cumsum(rng.normal(0.0, 0.01, (40, 17, 3)), axis=0)
    truth_m[..., 2] += 1.0
    in_cam = np.einsum("cij,fkj->fcki", projections[:, :, :3], truth_m) + projections[:, None, :, 3]
    points_px = in_cam[..., :2] / in_cam[..., 2:] + rng.normal(0.0, 3.0, (40, 4, 17, 2))
    # Whole views that are wrong, so that two starts compete; and joints that one camera alone sees.
    points_px[rng.random((40, 4, 17)) < 0.2] += 150.0
    points_px[rng.random((40, 4, 17)) < 0.3] = np.nan
    weights = rng.uniform(0.2, 1.0, (40, 4, 17))
    alone_m = triangulate_robust(projections, points_px, weights)
    padded = np.pad(alone_m, ((2, 2), (0, 0), (0, 0)), constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 5, axis=0)
    empty = np.isnan(windows).all(-1)
    guess_m = np.where(empty, np.nan, np.nanmedian(np.where(empty[..., None], 0.0, windows), axis=-1))
    expected_m = triangulate_robust(projections, points_px, weights, guess_m)
    assert np.isnan(alone_m).any(-1).mean() > 0.02
    assert (np.abs(expected_m - alone_m).max(-1) > 0.05).any()
    np.testing.assert_allclose(triangulate_frames(projections, points_px, weights), expected_m, atol=1e-9)


@pytest.mark.parametrize("seed", range(30))
def test_assignment_is_scipys(seed: int) -> None:
    rng = np.random.default_rng(seed)
    num_rows, num_columns = (int(number) for number in rng.integers(1, 9, 2))
    affinity = rng.uniform(-1.0, 1.0, (num_rows, num_columns))
    room = make_workspace(num_rows, num_columns)
    room.affinity[:] = affinity
    room.rows[:], room.columns[:], room.match[:] = np.arange(num_rows), np.arange(num_columns), -1
    assign(num_rows, num_columns, room)
    rows, columns = linear_sum_assignment(np.maximum(affinity, 0.0), maximize=True)
    expected = np.full(num_rows, -1)
    expected[rows] = np.where(affinity[rows, columns] > 0, columns, -1)
    np.testing.assert_array_equal(room.match, expected)


def test_epipolar_affinity_is_that_of_reference(ring: tuple[Camera, ...]) -> None:
    rng = np.random.default_rng(1)
    fundamental = make_rig(ring).fundamental[0, 1]
    left_px, right_px = rng.uniform(300.0, 600.0, (2, 17, 2))
    score = (rng.random((2, 17)) > 0.3).astype(float)
    expected = epipolar_affinity(
        fundamental,
        np.where(score[0][:, None] > 0, left_px, np.nan)[None],
        np.where(score[1][:, None] > 0, right_px, np.nan)[None],
        200.0,
    )[0, 0]
    found = kernels.epipolar_affinity(fundamental, left_px, score[0], right_px, score[1], 200.0)
    assert found == pytest.approx(expected, abs=1e-12)


def test_nothing_is_left_to_compile_after_warming_up() -> None:
    warm_up()
    compiled = (kernels.track, kernels.observe, observation_kernels.locate)
    known = [len(one.signatures) for one in compiled]
    simulation = record(replace(SCENES["room"], duration_s=1.0), 0)
    parameters = derive_parameters(simulation.cameras, simulation.timebase.frame_rate_hz)
    tracks, _ = reconstruct_tracks(
        simulation.cameras, simulation.times, simulation.detections, simulation.timebase, parameters
    )
    assert tracks
    assert [len(one.signatures) for one in compiled] == known
