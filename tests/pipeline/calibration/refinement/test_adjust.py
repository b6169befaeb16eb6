"""Adjustment of cameras: derivatives, recovery and standard deviations."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.calibration.refinement.adjust import (
    FOCAL,
    NUM_PARAMETERS,
    PRIOR_SIGMA,
    adjust,
    camera_offsets,
    linearise,
    move_camera,
)
from pipeline.calibration.refinement.gauge import align_world
from pipeline.geometry.camera import project
from tests.pipeline.calibration.refinement.people import disturb, ring, see, walk

CAMERAS = ring()
POSES = np.ones((4, NUM_PARAMETERS), bool)
POSES[:, FOCAL] = False


@settings(max_examples=20, deadline=None)
@given(
    place=st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), st.floats(0.0, 2.0)),
    camera=st.integers(0, 3),
)
def test_derivatives_are_those_of_the_projection(place: tuple[float, float, float], camera: int) -> None:
    point_m, one = np.array([place]), CAMERAS[camera]
    projected_px, by_camera, by_point = linearise(one, point_m)
    np.testing.assert_allclose(projected_px, project(one, point_m), rtol=0, atol=1e-9)
    tiny = 1e-6
    for k in range(NUM_PARAMETERS):
        step = np.eye(NUM_PARAMETERS)[k] * tiny
        numeric = (project(move_camera(one, step), point_m) - project(move_camera(one, -step), point_m)) / (2 * tiny)
        np.testing.assert_allclose(by_camera[..., k], numeric, rtol=1e-5, atol=1e-3)
    for k in range(3):
        step_m = np.eye(3)[k] * tiny
        numeric = (project(one, point_m + step_m) - project(one, point_m - step_m)) / (2 * tiny)
        np.testing.assert_allclose(by_point[..., k], numeric, rtol=1e-5, atol=1e-3)


def test_offsets_are_the_steps_that_lead_to_a_camera() -> None:
    steps = np.random.default_rng(0).normal(0.0, 0.02, (4, NUM_PARAMETERS))
    moved = [move_camera(camera, step) for camera, step in zip(CAMERAS, steps, strict=True)]
    np.testing.assert_allclose(camera_offsets(CAMERAS, moved), steps, atol=1e-12)


def test_exact_sightings_give_the_exact_cameras_and_wrong_views_do_not_pull_them() -> None:
    rng = np.random.default_rng(1)
    given_cameras = [disturb(camera, rng) for camera in CAMERAS]
    sightings = see(CAMERAS, *walk(10.0), noise_px=0.0)
    found = adjust(given_cameras, given_cameras, sightings, POSES)
    offsets = camera_offsets(CAMERAS, align_world(CAMERAS, found.cameras))
    np.testing.assert_allclose(offsets, 0.0, atol=2e-4)


def test_parameters_that_are_not_free_stay() -> None:
    rng = np.random.default_rng(2)
    given_cameras = [disturb(camera, rng) for camera in CAMERAS]
    free = np.zeros((4, NUM_PARAMETERS), bool)
    free[1:, :3] = True
    found = adjust(given_cameras, CAMERAS, see(CAMERAS, *walk(5.0)), free)
    offsets = camera_offsets(given_cameras, found.cameras)
    assert np.abs(offsets[~free]).max() < 1e-12
    assert np.abs(offsets[1:, :3]).max() > np.radians(0.3)
    assert (found.sigma[~free] == 0.0).all()


def test_standard_deviations_are_the_spread_of_repeats() -> None:
    seen = [see(CAMERAS, *walk(4.0), seed=seed) for seed in range(10)]
    found = [adjust(CAMERAS, CAMERAS, sightings, POSES) for sightings in seen]
    offsets = np.array([camera_offsets(CAMERAS, align_world(CAMERAS, one.cameras)) for one in found])
    spread = np.sqrt((offsets**2).mean(0))
    sigma = np.mean([one.sigma for one in found], axis=0)
    for parameters in (slice(0, 3), slice(3, 6)):
        ratio = np.sqrt((spread[:, parameters] ** 2).mean()) / np.sqrt((sigma[:, parameters] ** 2).mean())
        assert 0.7 < ratio < 1.4


def test_a_camera_that_sees_nobody_is_as_uncertain_as_before() -> None:
    sightings = see(CAMERAS, *walk(5.0))
    hidden = np.zeros(sightings.points_px.shape[:2], bool)
    hidden[:, 3] = True
    sigma = adjust(CAMERAS, CAMERAS, sightings.without(hidden), POSES).sigma
    assert sigma[3, :3].min() > 0.5 * PRIOR_SIGMA[0]
    assert sigma[:3, :3].max() < np.radians(0.2)


def test_focal_lengths_may_be_free_for_some_cameras_alone() -> None:
    free = POSES.copy()
    free[:2, FOCAL] = True
    sigma = adjust(CAMERAS, CAMERAS, see(CAMERAS, *walk(5.0)), free).sigma
    assert (sigma[2:, FOCAL] == 0.0).all()
    assert (sigma[:2, FOCAL] > 0.0).all()
    assert sigma[:, :3].max() < np.radians(0.2)
