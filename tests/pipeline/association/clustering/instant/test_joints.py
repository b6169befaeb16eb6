import numpy as np
from scipy.optimize import minimize

from pipeline.association.clustering.instant.joints import refine
from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import image_from_world


def reprojection_sum(projections: np.ndarray, xyz_m: np.ndarray, points_px: np.ndarray, weight: np.ndarray) -> float:
    in_cam = projections[:, :, :3] @ xyz_m + projections[:, :, 3]
    return float((weight * np.linalg.norm(in_cam[:, :2] / in_cam[:, 2:] - points_px, axis=-1)).sum())


def test_sum_of_reprojection_errors_is_least(ring: tuple[Camera, ...]) -> None:
    rng = np.random.default_rng(2)
    projections = np.array([image_from_world(camera) for camera in ring])
    truth_m = rng.uniform([-0.5, -0.5, 0.5], [0.5, 0.5, 1.5], (6, 3))
    in_cam = np.einsum("cij,kj->kci", projections[:, :, :3], truth_m) + projections[:, :, 3]
    points_px = in_cam[..., :2] / in_cam[..., 2:] + rng.normal(0.0, 4.0, (6, 4, 2))
    weight = rng.uniform(0.3, 1.0, (6, 4))
    found_m = refine(projections, truth_m + 0.05, points_px, weight)
    for k in range(6):
        best = minimize(
            lambda xyz_m, k=k: reprojection_sum(projections, xyz_m, points_px[k], weight[k]),
            truth_m[k],
            method="Nelder-Mead",
            options={"xatol": 1e-7, "fatol": 1e-7, "maxiter": 5000},
        )
        assert reprojection_sum(projections, found_m[k], points_px[k], weight[k]) <= 1.05 * best.fun


def test_views_without_confidence_do_not_count(ring: tuple[Camera, ...]) -> None:
    projections = np.array([image_from_world(camera) for camera in ring])
    truth_m = np.array([[0.1, 0.2, 1.2]])
    in_cam = np.einsum("cij,kj->kci", projections[:, :, :3], truth_m) + projections[:, :, 3]
    points_px = in_cam[..., :2] / in_cam[..., 2:]
    points_px[0, 2] = np.nan
    found_m = refine(projections, truth_m + 0.03, points_px, np.array([[1.0, 1.0, 0.0, 1.0]]))
    np.testing.assert_allclose(found_m, truth_m, atol=1e-6)
