"""Adjustment of cameras to sightings: recovery and standard deviations."""

import numpy as np
import pytest

from pipeline.calibration.adjustment.parameters import (
    EXTRINSICS,
    FOCAL,
    move_camera,
    none_free,
    offsets,
    world_moves,
)
from pipeline.calibration.refinement.adjust import adjust_to_sightings
from pipeline.calibration.similarity import align_world
from pipeline.geometry.camera import project
from tests.pipeline.calibration.refinement.people import disturb, ring, see, walk

CAMERAS = ring()
POSES = none_free(4)
POSES[:, EXTRINSICS] = True


def test_exact_sightings_give_the_exact_cameras_and_wrong_views_do_not_pull_them() -> None:
    rng = np.random.default_rng(1)
    given_cameras = [disturb(camera, rng) for camera in CAMERAS]
    sightings = see(CAMERAS, *walk(10.0), noise_px=0.0)
    found = adjust_to_sightings(given_cameras, given_cameras, sightings, POSES)
    errors = offsets(CAMERAS, align_world(CAMERAS, found.cameras))
    np.testing.assert_allclose(errors, 0.0, atol=2e-4)


def test_parameters_that_are_not_free_stay() -> None:
    rng = np.random.default_rng(2)
    given_cameras = [disturb(camera, rng) for camera in CAMERAS]
    free = none_free(4)
    free[1:, :3] = True
    found = adjust_to_sightings(given_cameras, CAMERAS, see(CAMERAS, *walk(5.0)), free)
    steps = offsets(given_cameras, found.cameras)
    assert np.abs(steps[~free]).max() < 1e-12
    assert np.abs(steps[1:, :3]).max() > np.radians(0.3)
    assert (found.sigma[~free] == 0.0).all()


@pytest.mark.slow
def test_standard_deviations_are_the_spread_of_repeats() -> None:
    seen = [see(CAMERAS, *walk(4.0), seed=seed) for seed in range(10)]
    found = [adjust_to_sightings(CAMERAS, CAMERAS, sightings, POSES) for sightings in seen]
    errors = np.array([offsets(CAMERAS, align_world(CAMERAS, adjusted.cameras)) for adjusted in found])
    spread = np.sqrt((errors**2).mean(0))
    sigma = np.mean([adjusted.sigma for adjusted in found], axis=0)
    for parameters in (slice(0, 3), slice(3, 6)):
        ratio = np.sqrt((spread[:, parameters] ** 2).mean()) / np.sqrt((sigma[:, parameters] ** 2).mean())
        assert 0.7 < ratio < 1.4


def test_a_camera_that_sees_nobody_is_as_uncertain_as_before() -> None:
    sightings = see(CAMERAS, *walk(5.0))
    hidden = np.zeros(sightings.points_px.shape[:2], bool)
    hidden[:, 3] = True
    sigma = adjust_to_sightings(CAMERAS, CAMERAS, sightings.without(hidden), POSES).sigma
    assert sigma[3, :3].min() > 0.5 * np.radians(5.0)
    assert sigma[:3, :3].max() < np.radians(0.2)


def test_focal_lengths_may_be_free_for_some_cameras_alone() -> None:
    free = POSES.copy()
    free[:2, FOCAL] = True
    sigma = adjust_to_sightings(CAMERAS, CAMERAS, see(CAMERAS, *walk(5.0)), free).sigma
    assert (sigma[2:, FOCAL] == 0.0).all()
    assert (sigma[:2, FOCAL] > 0.0).all()
    assert sigma[:, :3].max() < np.radians(0.2)


def test_errors_are_within_two_standard_deviations() -> None:
    """With calibrations that are off, wrong views, and the world where the priors' metric leaves it."""
    rng = np.random.default_rng(6)
    is_within = []
    for seed in range(12):
        start = [disturb(camera, rng, 0.5, 0.01) for camera in CAMERAS]
        adjusted = adjust_to_sightings(CAMERAS, start, see(CAMERAS, *walk(4.0, seed), seed=seed), POSES)
        scale = np.tile(np.repeat([np.radians(5.0), 0.3], 3), 4)
        errors = offsets(CAMERAS, adjusted.cameras)[:, EXTRINSICS].ravel() / scale
        moves = world_moves(CAMERAS)[:, EXTRINSICS].reshape(24, 7) / scale[:, None]
        errors -= moves @ np.linalg.lstsq(moves, errors)[0]
        is_within.append(np.abs(errors) < 2 * adjusted.sigma[:, EXTRINSICS].ravel() / scale)
    assert 0.92 < np.mean(is_within) < 0.99


def test_moves_of_the_world_change_no_picture() -> None:
    point_m, tiny = np.array([[0.3, -0.2, 1.1]]), 1e-6
    center_m = np.mean([camera.cam_from_world.inverse().translation_m for camera in CAMERAS], axis=0)
    arm_m = point_m - center_m
    of_point = [*np.eye(3), *(np.cross(axis, arm_m[0]) for axis in np.eye(3)), arm_m[0]]
    for number, camera in enumerate(CAMERAS):
        for k, point_step in enumerate(of_point):
            moved = move_camera(camera, tiny * world_moves(CAMERAS)[number, :, k])
            np.testing.assert_allclose(project(moved, point_m + tiny * point_step), project(camera, point_m), atol=1e-6)
