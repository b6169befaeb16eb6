"""Derivatives of projections, parameters of cameras, and structures, against finite differences."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.calibration.adjustment.parameters import NUM_PARAMETERS, linearise, move_camera, offsets
from pipeline.calibration.adjustment.problem import FreePoints, RigidBodies, Structure
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.geometry.camera import look_at, project

# All of OpenCV's twelve coefficients, of the size that lenses have.
COEFFICIENTS = np.array([-0.1, 0.03, 5e-4, -4e-4, 0.01, 0.02, -0.01, 0.004, 2e-4, -1e-4, -3e-4, 1e-4])


def camera_with(num_coefficients: int) -> Camera:
    matrix = np.array([[800.0, 1.5, 630.0], [0.0, 790.0, 350.0], [0.0, 0.0, 1.0]])
    pose = look_at(np.array([3.0, -1.0, 1.7]), np.array([0.1, 0.2, 1.0]))
    return Camera("cam", (1280, 720), read_only(matrix), read_only(COEFFICIENTS[:num_coefficients].copy()), pose)


@given(
    place=st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), st.floats(0.0, 2.0)),
    num_coefficients=st.sampled_from((0, 4, 5, 8, 12)),
)
def test_derivatives_are_those_of_projection(place: tuple[float, float, float], num_coefficients: int) -> None:
    camera, point_m, tiny = camera_with(num_coefficients), np.array([place]), 1e-6
    found = linearise(camera, point_m)
    np.testing.assert_allclose(found.points_px, project(camera, point_m), atol=1e-9)
    # Coefficients that the camera does not have are zero: pad it, so that a step can change them.
    padded = np.zeros(12)
    padded[:num_coefficients] = COEFFICIENTS[:num_coefficients]
    full = Camera("cam", camera.size_px, camera.matrix, padded, camera.cam_from_world)
    for k in range(NUM_PARAMETERS):
        # The skew is not a parameter, but grows with the focal length.
        step = np.eye(NUM_PARAMETERS)[k] * tiny
        numeric = (project(move_camera(full, step), point_m) - project(move_camera(full, -step), point_m)) / (2 * tiny)
        np.testing.assert_allclose(found.by_camera[..., k], numeric, rtol=1e-5, atol=2e-3)
    for k in range(3):
        step_m = np.eye(3)[k] * tiny
        numeric = (project(camera, point_m + step_m) - project(camera, point_m - step_m)) / (2 * tiny)
        np.testing.assert_allclose(found.by_point[..., k], numeric, rtol=1e-5, atol=2e-3)


# All places are in front of the camera, at x = 3 m.
@given(place=st.tuples(st.floats(-3, 2), st.floats(-1.5, 1.5), st.floats(0.0, 2.0)))
def test_derivatives_of_fisheye_are_those_of_its_projection(place: tuple[float, float, float]) -> None:
    fisheye = replace(camera_with(4), lens="fisheye")
    point_m, tiny = np.array([place]), 1e-6
    found = linearise(fisheye, point_m)
    np.testing.assert_allclose(found.points_px, project(fisheye, point_m), atol=1e-9)
    assert not found.by_camera[..., 14:].any()
    for k in range(14):
        step = np.eye(NUM_PARAMETERS)[k] * tiny
        ahead, behind = (project(move_camera(fisheye, sign * step), point_m) for sign in (1, -1))
        np.testing.assert_allclose(found.by_camera[..., k], (ahead - behind) / (2 * tiny), rtol=1e-5, atol=2e-3)
    for k in range(3):
        step_m = np.eye(3)[k] * tiny
        numeric = (project(fisheye, point_m + step_m) - project(fisheye, point_m - step_m)) / (2 * tiny)
        np.testing.assert_allclose(found.by_point[..., k], numeric, rtol=1e-5, atol=2e-3)


def test_points_behind_camera_are_nan() -> None:
    assert np.isnan(linearise(camera_with(5), np.array([[6.0, -2.0, 2.0]])).points_px).all()


@pytest.mark.parametrize("num_coefficients", [0, 4, 5, 8, 12])
def test_offsets_are_steps_that_lead_to_camera(num_coefficients: int) -> None:
    step = np.random.default_rng(0).normal(0.0, 0.02, NUM_PARAMETERS)
    step[10 + num_coefficients :] = 0.0
    camera = camera_with(num_coefficients)
    np.testing.assert_allclose(offsets([camera], [move_camera(camera, step)])[0], step, atol=1e-12)
    assert len(move_camera(camera, step).distortion) == num_coefficients


@given(seed=st.integers(0, 1000), is_body=st.booleans())
def test_derivatives_of_structure_are_those_of_its_points(seed: int, is_body: bool) -> None:
    rng, tiny = np.random.default_rng(seed), 1e-6
    structure: Structure = FreePoints(rng.normal(size=(2, 3)))
    if is_body:
        pose = Rigid3(look_at(rng.normal(size=3), rng.normal(size=3)).rotation, rng.normal(size=3))
        structure = RigidBodies(np.stack([np.eye(3), pose.rotation]), np.stack([np.zeros(3), pose.translation_m]))
    block, model_m = np.array([1, 0, 1]), rng.normal(size=(3, 3))
    _, derivatives = structure.in_world(block, model_m)
    for k in range(structure.block_size):
        steps = np.zeros((2, structure.block_size))
        steps[1, k] = tiny
        ahead, _ = structure.moved(steps).in_world(block, model_m)
        behind, _ = structure.moved(-steps).in_world(block, model_m)
        numeric = (ahead - behind) / (2 * tiny)
        np.testing.assert_allclose(derivatives[[0, 2], :, k], numeric[[0, 2]], atol=1e-8)
        np.testing.assert_array_equal(numeric[1], 0.0)
