import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.geometry.camera import center_in_world, image_from_world, project, rays_in_world
from pipeline.geometry.epipolar import distance_to_line_px, epipolar_distance_px, fundamental_matrices
from pipeline.geometry.undistortion import undistort_px

COEFFICIENTS = {
    "none": [],
    "mild": [-0.11, 0.03, 0.001, -0.0005],
    "wide": [-0.32, 0.12, 0.001, -0.002, -0.02],
    "rational": [0.4, -0.2, 0.0005, 0.0003, 0.02, 0.7, -0.1, 0.03],
    "prism": [-0.2, 0.05, 0.001, 0.001, 0.0, 0.0, 0.0, 0.0, 0.002, -0.001, 0.003, 0.0004],
}


def camera(coefficients: list[float], turn: tuple[float, float, float] = (0.3, -0.2, 0.1)) -> Camera:
    matrix = np.array([[900.0, 0.0, 631.5], [0.0, 905.0, 362.0], [0.0, 0.0, 1.0]])
    pose = Rigid3(Rotation.from_rotvec(turn).as_matrix(), np.array([0.2, -0.1, 4.0]))
    return Camera("a", (1280, 720), matrix, np.array(coefficients), pose)


def points(seed: int, count: int = 50) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (count, 3))


@pytest.mark.parametrize("kind", COEFFICIENTS)
def test_projection_is_opencvs(kind: str) -> None:
    one = camera(COEFFICIENTS[kind])
    pose = one.cam_from_world
    expected, _ = cv2.projectPoints(
        points(1), Rotation.from_matrix(pose.rotation).as_rotvec(), pose.translation_m, one.matrix, one.distortion
    )
    np.testing.assert_allclose(project(one, points(1)), expected[:, 0], atol=1e-8)


@pytest.mark.parametrize("kind", COEFFICIENTS)
def test_undistortion_inverts_distortion(kind: str) -> None:
    one = camera(COEFFICIENTS[kind])
    homogeneous = np.column_stack([points(2), np.ones(50)]) @ image_from_world(one).T
    np.testing.assert_allclose(
        undistort_px(one, project(one, points(2))), homogeneous[:, :2] / homogeneous[:, 2:], atol=1e-7
    )


@pytest.mark.parametrize("kind", COEFFICIENTS)
def test_rays_go_through_points_that_they_see(kind: str) -> None:
    one = camera(COEFFICIENTS[kind])
    expected = points(3) - center_in_world(one)
    expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
    np.testing.assert_allclose(rays_in_world(one, undistort_px(one, project(one, points(3)))), expected, atol=1e-9)


def test_behind_camera_and_nan() -> None:
    one = camera([])
    behind = center_in_world(one) - one.cam_from_world.rotation[2]
    assert np.isnan(project(one, behind)).all()
    assert np.isnan(project(one, np.full(3, np.nan))).all()
    assert np.isnan(rays_in_world(one, np.array([np.nan, 3.0]))).all()


@given(shift=st.tuples(*[st.floats(-1.0, 1.0)] * 3), turn=st.tuples(*[st.floats(-0.4, 0.4)] * 3))
def test_epipolar_lines_contain_other_views_points(
    shift: tuple[float, float, float], turn: tuple[float, float, float]
) -> None:
    left = camera([])
    pose = Rigid3(Rotation.from_rotvec(turn).as_matrix(), np.array(shift) + np.array([1.5, 0.0, 4.0]))
    right = Camera("b", left.size_px, left.matrix, left.distortion, pose)
    seen_left, seen_right = project(left, points(4)), project(right, points(4))
    fundamental = fundamental_matrices([left, right])[0, 1]
    np.testing.assert_allclose(epipolar_distance_px(fundamental, seen_left, seen_right), 0.0, atol=1e-6)


def test_epipolar_distance_is_mean_of_both_images() -> None:
    """Epipolar lines of two equal cameras side by side are rows."""
    left = camera([], turn=(0.0, 0.0, 0.0))
    right = Camera("b", left.size_px, left.matrix, left.distortion, Rigid3(np.eye(3), np.array([-0.8, -0.1, 4.0])))
    seen_left, seen_right = np.array([[600.0, 300.0]]), np.array([[400.0, 312.0]])
    np.testing.assert_allclose(
        epipolar_distance_px(fundamental_matrices([left, right])[0, 1], seen_left, seen_right), 12.0
    )


def test_distance_to_line() -> None:
    np.testing.assert_allclose(distance_to_line_px(np.array([[3.0, 4.0]]), np.array([[0.0, 2.0, -2.0]])), 3.0)
