"""Fisheye lenses against OpenCV's own module, and the laws of the model."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.geometry.camera import project
from pipeline.geometry.fisheye import (
    MAX_ANGLE_RAD,
    angle_limit_rad,
    distort_fisheye,
    fisheye_by_coefficients,
    fisheye_by_ideal,
    undistort_fisheye,
)
from pipeline.geometry.tracks import reproject
from pipeline.geometry.undistortion import undistort_px

COEFFICIENTS = {
    "none": [0.0, 0.0, 0.0, 0.0],
    "action camera": [0.035, -0.011, 0.002, -0.0005],
    "wide": [-0.08, 0.02, -0.015, 0.003],
}


def camera(coefficients: list[float]) -> Camera:
    matrix = np.array([[520.0, 0.7, 631.5], [0.0, 525.0, 362.0], [0.0, 0.0, 1.0]])
    pose = Rigid3(Rotation.from_rotvec((0.3, -0.2, 0.1)).as_matrix(), np.array([0.2, -0.1, 1.0]))
    return Camera("a", (1280, 720), read_only(matrix), read_only(np.array(coefficients)), pose, lens="fisheye")


def points_at(one: Camera, angles_rad: np.ndarray) -> np.ndarray:
    """World points at angles from the optical axis, all around it."""
    around = np.random.default_rng(0).uniform(0, 2 * np.pi, len(angles_rad))
    across = np.sin(angles_rad)
    in_cam = np.stack([across * np.cos(around), across * np.sin(around), np.cos(angles_rad)], axis=-1) * 3.0
    return one.cam_from_world.inverse().apply(in_cam)


@pytest.mark.parametrize("kind", COEFFICIENTS)
def test_projection_is_opencvs(kind: str) -> None:
    one = camera(COEFFICIENTS[kind])
    points_m = points_at(one, np.linspace(0.0, 0.999 * angle_limit_rad(one.distortion), 200))
    pose, skew = one.cam_from_world, one.matrix[0, 1] / one.matrix[0, 0]
    expected, _ = cv2.fisheye.projectPoints(
        points_m[:, None],
        Rotation.from_matrix(pose.rotation).as_rotvec(),
        pose.translation_m,
        np.diag([520.0, 525.0, 1.0]) + np.outer([631.5, 362.0, 0.0], [0, 0, 1]),
        one.distortion,
        alpha=skew,
    )
    np.testing.assert_allclose(project(one, points_m), expected[:, 0], atol=1e-6)


@pytest.mark.parametrize("kind", COEFFICIENTS)
def test_undistortion_inverts_projection(kind: str) -> None:
    one = camera(COEFFICIENTS[kind])
    angles_rad = np.linspace(0.0, 0.99 * angle_limit_rad(one.distortion), 300)
    points_m = points_at(one, angles_rad)
    in_cam = one.cam_from_world.apply(points_m)
    ideal_px = in_cam / in_cam[:, 2:] @ one.matrix.T
    found_px = undistort_px(one, project(one, points_m).reshape(3, 100, 2)).reshape(-1, 2)
    np.testing.assert_allclose(found_px, ideal_px[:, :2], rtol=1e-9, atol=1e-6)


def test_undistortion_is_opencvs() -> None:
    one = camera(COEFFICIENTS["action camera"])
    seen_px = np.stack(np.meshgrid(np.linspace(0, 1279, 20), np.linspace(0, 719, 12)), -1).reshape(-1, 2)
    flat = one.matrix * np.array([[1, 0, 1], [1, 1, 1], [1, 1, 1]])
    flat_camera = Camera("a", one.size_px, flat, one.distortion, one.cam_from_world, lens="fisheye")
    expected = cv2.fisheye.undistortPoints(seen_px[:, None], flat, one.distortion, P=flat)[:, 0]
    np.testing.assert_allclose(undistort_px(flat_camera, seen_px), expected, atol=1e-4)


def test_points_beyond_limit_are_nan() -> None:
    one = camera(COEFFICIENTS["none"])
    assert angle_limit_rad(one.distortion) == MAX_ANGLE_RAD
    inside, outside = points_at(one, np.radians([84.9, 85.1]))
    assert np.isfinite(project(one, inside)).all()
    assert np.isnan(project(one, outside)).all()
    assert np.isnan(project(one, np.full(3, np.nan))).all()
    limit_px = one.matrix[0, 2] + one.matrix[0, 0] * MAX_ANGLE_RAD
    seen_px = np.array([[limit_px - 1e-3, 362.0], [limit_px + 1e-3, 362.0], [np.nan, 362.0]])
    np.testing.assert_array_equal(np.isfinite(undistort_px(one, seen_px)).all(-1), [True, False, False])


def test_limit_is_where_radius_stops_growing() -> None:
    folding = np.array([-0.4, 0.0, 0.0, 0.0])  # 1 - 1.2 t^2 = 0
    assert angle_limit_rad(folding) == pytest.approx(np.sqrt(1 / 1.2))
    beyond = np.array([[np.tan(0.95), 0.0]])
    assert np.isnan(distort_fisheye(beyond, folding)).all()
    assert np.isnan(undistort_fisheye(np.array([[0.7, 0.0]]), folding)).all()


@given(
    distortion=st.tuples(*[st.floats(-0.3, 0.3)] * 4),
    share=st.floats(0.0, 0.98),
    around=st.floats(0, 6.3),
)
def test_undistortion_inverts_distortion(
    distortion: tuple[float, float, float, float], share: float, around: float
) -> None:
    coefficients = np.array(distortion)
    radius = np.tan(share * angle_limit_rad(coefficients))
    points = radius * np.array([[np.cos(around), np.sin(around)]])
    found = undistort_fisheye(distort_fisheye(points, coefficients), coefficients)
    np.testing.assert_allclose(found, points, rtol=1e-6, atol=1e-9)


@given(x=st.floats(-3, 3), y=st.floats(-3, 3))
def test_derivatives(x: float, y: float) -> None:
    points, distortion, tiny = np.array([[x, y]]), np.array(COEFFICIENTS["wide"]), 1e-6
    by_ideal, by_coefficients = fisheye_by_ideal(points, distortion), fisheye_by_coefficients(points)
    for axis in range(2):
        step = np.eye(2)[axis] * tiny
        numeric = (distort_fisheye(points + step, distortion) - distort_fisheye(points - step, distortion)) / (2 * tiny)
        np.testing.assert_allclose(by_ideal[..., axis], numeric, atol=1e-7)
    for k in range(4):
        step = np.eye(4)[k] * tiny
        numeric = (distort_fisheye(points, distortion + step) - distort_fisheye(points, distortion - step)) / (2 * tiny)
        np.testing.assert_allclose(by_coefficients[..., k], numeric, atol=1e-7)


@pytest.mark.slow
def test_compiled_reprojection_is_that_of_numpy() -> None:
    """A fisheye beside a standard lens: each is reprojected by its own model."""
    fisheye = camera(COEFFICIENTS["action camera"])
    standard = Camera("b", fisheye.size_px, fisheye.matrix, np.array([-0.1, 0.02, 0.001, 0.0]), fisheye.cam_from_world)
    xyz_m = points_at(fisheye, np.linspace(0.0, 0.7, 12)).reshape(2, 6, 3)
    off_px = np.random.default_rng(1).normal(0, 3, (2, 2, 6, 2))
    points_px = np.stack([project(one, xyz_m) for one in (fisheye, standard)], axis=1) + off_px
    error_px, _, views = reproject([fisheye, standard], xyz_m, points_px, np.ones((2, 2, 6)))
    np.testing.assert_allclose(error_px, np.linalg.norm(off_px, axis=-1).mean(axis=1), atol=1e-9)
    assert (views == 2).all()
