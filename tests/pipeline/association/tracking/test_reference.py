from dataclasses import replace

import numpy as np
import pytest

from pipeline.association.tracking.tracking_parameters import TrackingParameters, derive_parameters, viewed_point_m
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import InputError
from pipeline.core.options.rules import change_parameters
from pipeline.geometry.camera import center_in_world, project, rays_in_world
from pipeline.geometry.undistortion import undistort_px
from tests.pipeline.association.tracking.reference import affinity, correspondence_2d, correspondence_3d, predict


@pytest.fixture
def parameters() -> TrackingParameters:
    return TrackingParameters(
        alpha_2d_px_s=500.0, alpha_epipolar_px=30.0, lambda_a_hz=5.0, lambda_t_hz=10.0, instant_s=0.03
    )


def test_correspondence_2d_is_equation_2(parameters: TrackingParameters) -> None:
    points_px = np.array([[[110.0, 100.0], [np.nan, np.nan]]])
    last_px = np.array([[[100.0, 100.0], [50.0, 50.0]]])
    terms = correspondence_2d(points_px, last_px, np.array([0.04]), parameters)
    # 10 px of the 20 px that 500 px/s allow in 0.04 s.
    np.testing.assert_allclose(terms[0, 0, 0], 0.4 * 0.5 * np.exp(-5.0 * 0.04))
    assert np.isnan(terms[0, 0, 1])


def test_correspondence_2d_is_cut_at_minus_one(parameters: TrackingParameters) -> None:
    terms = correspondence_2d(np.full((1, 1, 2), 900.0), np.zeros((1, 1, 2)), np.array([0.04]), parameters)
    np.testing.assert_allclose(terms, -0.4 * np.exp(-0.2))


def test_correspondence_3d_is_equation_4(ring: tuple[Camera, ...], parameters: TrackingParameters) -> None:
    camera = ring[0]
    joint_m = np.array([0.2, -0.1, 1.2])
    rays = rays_in_world(camera, undistort_px(camera, project(camera, joint_m)))[None, None]
    across = np.cross(rays[0, 0], [0.0, 0.0, 1.0])
    predicted_m = (joint_m + 0.05 * across / np.linalg.norm(across))[None, None]
    terms = correspondence_3d(rays, center_in_world(camera), predicted_m, np.array([[0.1]]), parameters)
    np.testing.assert_allclose(terms[0, 0, 0], 0.6 * (1 - 0.05 / 0.15) * np.exp(-0.5), rtol=1e-6)


def test_point_behind_camera_fits_no_ray(ring: tuple[Camera, ...], parameters: TrackingParameters) -> None:
    camera = ring[0]
    center = center_in_world(camera)
    in_front = np.array([0.0, 0.0, 1.0])
    rays = rays_in_world(camera, undistort_px(camera, project(camera, in_front)))[None, None]
    behind = (2 * center - in_front)[None, None]
    terms = correspondence_3d(rays, center, behind, np.zeros((1, 1)), parameters)
    np.testing.assert_allclose(terms, -0.6)


def test_affinity_is_mean_over_shared_joints_and_needs_three() -> None:
    terms_3d = np.array([[[0.3, 0.6, 0.0, np.nan]], [[0.5, 0.5, np.nan, np.nan]]])
    terms_2d = np.array([[[0.3, np.nan, np.nan, 0.4]], [[0.4, 0.4, 0.4, 0.4]]])
    np.testing.assert_allclose(affinity(terms_2d, terms_3d), [[0.4], [-np.inf]])


def test_prediction_stands_still_after_while() -> None:
    start, velocity = np.zeros((1, 2, 3)), np.ones((1, 2, 3))
    moved = predict(start, velocity, np.array([[0.1, 3.0]]), max_extrapolation_s=0.25)
    np.testing.assert_allclose(moved[0, :, 0], [0.1, 0.25])


def test_defaults_follow_session(ring: tuple[Camera, ...]) -> None:
    np.testing.assert_allclose(viewed_point_m(ring), [0.0, 0.0, 1.0], atol=2e-3)
    slow, fast = derive_parameters(ring, 25.0), derive_parameters(ring, 50.0)
    np.testing.assert_allclose(slow.alpha_2d_px_s, 3.0 * 800.0 / np.hypot(4.0, 1.0), rtol=1e-3)
    assert (slow.lambda_a_hz, slow.lambda_t_hz) == (5.0, 10.0)
    assert fast.lambda_t_hz == 2 * slow.lambda_t_hz
    doubled = tuple(replace(camera, matrix=camera.matrix * [[2.0], [2.0], [1.0]]) for camera in ring)
    np.testing.assert_allclose(derive_parameters(doubled, 25.0).alpha_2d_px_s, 2 * slow.alpha_2d_px_s)


def test_every_parameter_can_be_set_and_wrong_one_is_said(parameters: TrackingParameters) -> None:
    changed = change_parameters(parameters, {"alpha_3d_m": 0.3, "weight_2d": 0.0, "confirm_instants": 5.0})
    assert (changed.alpha_3d_m, changed.weight_2d, changed.confirm_instants) == (0.3, 0.0, 5)
    assert changed.lambda_a_hz == parameters.lambda_a_hz
    wrong = {"alpha": 1.0, "alpha_3d_m": -1.0, "lambda_t_hz": float("nan"), "confirm_instants": 1.5}
    with pytest.raises(InputError) as raised:
        change_parameters(parameters, wrong)
    assert [problem.field for problem in raised.value.problems] == [None, *list(wrong)[1:]]
