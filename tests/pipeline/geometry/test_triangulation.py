import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import image_from_world, project
from pipeline.geometry.tracks import triangulate_instants
from pipeline.geometry.triangulation import plane_rows, triangulate, triangulate_robust
from tests.pipeline.conftest import ring_camera

RING: tuple[Camera, ...] = tuple(ring_camera(f"cam{k}", 0.3 + k * np.pi / 2) for k in range(4))
IDEAL = tuple(Camera(c.name, c.size_px, c.matrix, np.empty(0), c.cam_from_world) for c in RING)
PROJECTIONS = np.array([image_from_world(c) for c in IDEAL])


def seen(points_m: np.ndarray) -> np.ndarray:
    """Undistorted pixels (cameras, points, 2)."""
    return np.stack([project(c, points_m) for c in IDEAL])


@given(points_m=arrays(np.float64, (7, 3), elements=st.floats(-1.5, 1.5)))
def test_triangulation_inverts_projection(points_m: np.ndarray) -> None:
    points_px = seen(points_m)
    np.testing.assert_allclose(triangulate(PROJECTIONS, points_px, np.ones((4, 7))), points_m, atol=1e-8)
    np.testing.assert_allclose(triangulate_robust(PROJECTIONS, points_px, np.ones((4, 7))), points_m, atol=1e-8)


def test_instants_are_triangulated_from_distorted_pixels() -> None:
    points_m = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 3, 3))
    points_px = np.stack([project(camera, points_m) for camera in RING], axis=1)
    points_px[1, 0, 2] += 300.0  # a wrong view does not pull the point
    points_px[2, 1:, 0] = np.nan
    found_m = triangulate_instants(RING, points_px)
    assert np.isnan(found_m[2, 0]).all()
    found_m[2, 0] = points_m[2, 0]
    np.testing.assert_allclose(found_m, points_m, atol=1e-2)
    assert triangulate_instants(RING, points_px[:0]).shape == (0, 3, 3)


def test_rows_measure_metres_to_plane_through_ray() -> None:
    """Equations 7-9 with the norm of eq. 11: moving a point by 1 cm across the optical axis gives 1 cm."""
    target_m = np.array([[0.0, 0.0, 1.0]])
    rows = plane_rows(PROJECTIONS, seen(target_m))[0, 0]
    right = IDEAL[0].cam_from_world.rotation[0]
    moved = np.append(target_m[0] + 0.01 * right, 1.0)
    np.testing.assert_allclose(np.abs(rows @ moved), [0.01, 0.0], atol=1e-9)


def test_origin_of_world_does_not_matter() -> None:
    points_px = seen(np.array([[0.3, 0.2, 1.1]])) + np.random.default_rng(0).normal(0, 5, (4, 1, 2))
    shift = np.eye(4)
    shift[:3, 3] = [100.0, -50.0, 20.0]
    here = triangulate(PROJECTIONS, points_px, np.ones((4, 1)))
    there = triangulate(PROJECTIONS @ np.linalg.inv(shift), points_px, np.ones((4, 1)))
    np.testing.assert_allclose(there, here + shift[:3, 3], atol=1e-8)


def test_weights_decide_between_views_that_disagree() -> None:
    points_px = seen(np.array([[0.0, 0.0, 1.0]]))
    points_px[2] += 40.0
    even = triangulate(PROJECTIONS, points_px, np.ones((4, 1)))
    tilted = triangulate(PROJECTIONS, points_px, np.array([[1.0], [1.0], [0.1], [1.0]]))
    truth = np.array([[0.0, 0.0, 1.0]])
    assert np.linalg.norm(tilted - truth) < 0.1 * np.linalg.norm(even - truth)


def test_fewer_than_two_views_give_nan() -> None:
    points_px = seen(np.zeros((3, 3)))
    points_px[1:, 0] = np.nan
    weights = np.ones((4, 3))
    weights[:, 1] = [0.0, 0.0, 0.0, 1.0]
    found = triangulate(PROJECTIONS, points_px, weights)
    assert np.isnan(found[:2]).all()
    assert np.isfinite(found[2]).all()
    assert np.isnan(triangulate_robust(PROJECTIONS, points_px, weights)[:2]).all()


def test_rays_that_are_nearly_parallel_give_nan() -> None:
    twins = np.array([PROJECTIONS[0], PROJECTIONS[0]])
    points_px = seen(np.array([[0.0, 0.0, 1.0]]))[[0, 0]]
    assert np.isnan(triangulate(twins, points_px, np.ones((2, 1)))).all()


@pytest.mark.parametrize("camera", range(4))
def test_one_wrong_view_does_not_pull_point(camera: int) -> None:
    truth = np.random.default_rng(1).uniform(-0.8, 0.8, (30, 3))
    points_px = seen(truth)
    points_px[camera] += np.random.default_rng(2).choice([-1, 1], (30, 2)) * 90.0
    plain = np.linalg.norm(triangulate(PROJECTIONS, points_px, np.ones((4, 30))) - truth, axis=-1)
    robust = np.linalg.norm(triangulate_robust(PROJECTIONS, points_px, np.ones((4, 30))) - truth, axis=-1)
    assert plain.min() > 0.1
    assert robust.max() < 0.03


def test_of_two_views_that_contradict_third_guess_decides() -> None:
    """Of three views one is wrong, which a prediction from earlier frames identifies."""
    truth = np.array([[0.2, 0.1, 1.2]])
    points_px = seen(truth)[:3]
    points_px[0] += [[220.0, 0.0]]
    found = triangulate_robust(PROJECTIONS[:3], points_px, np.ones((3, 1)), guess_m=truth + 0.03)
    np.testing.assert_allclose(found, truth, atol=0.02)
