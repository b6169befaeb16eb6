"""Incremental triangulation: effects of time penalty and norm."""

import numpy as np
import pytest

from pipeline.geometry.camera import image_from_world
from pipeline.validation.evaluation.baselines import Triangulation, triangulate_last
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras

CAMERAS = build_cameras(Rig(Layout.RING, 4, (4.0, 4.0), 2.2), np.random.default_rng(0))
PROJECTIONS = np.array([image_from_world(camera) for camera in CAMERAS])
POINTS_M = np.array([[0.1, 0.2, 1.0], [-0.5, 0.4, 1.7], [0.3, -0.6, 0.2]])


def seen_px(points_m: np.ndarray) -> np.ndarray:
    in_cam = points_m @ PROJECTIONS[:, :, :3].swapaxes(1, 2) + PROJECTIONS[:, None, :, 3]
    return in_cam[..., :2] / in_cam[..., 2:]


@pytest.mark.parametrize("kind", Triangulation)
def test_views_that_agree_give_point(kind: Triangulation) -> None:
    points_px = seen_px(POINTS_M)
    points_px[0, 0] = np.nan
    points_px[:3, 2] = np.nan
    found_m = triangulate_last(PROJECTIONS, points_px, np.array([1.0, 0.5, 0.1, 1.0]), kind)
    np.testing.assert_allclose(found_m[:2], POINTS_M[:2], atol=1e-9)
    assert np.isnan(found_m[2]).all()


def test_old_view_pulls_less_than_new_one() -> None:
    points_px = seen_px(POINTS_M)
    points_px[3] = seen_px(POINTS_M + np.array([0.2, 0.0, 0.0]))[3]
    penalty = np.array([1.0, 1.0, 1.0, 0.05])
    error_m = {
        kind: np.linalg.norm(triangulate_last(PROJECTIONS, points_px, penalty, kind) - POINTS_M, axis=-1)
        for kind in Triangulation
    }
    assert (error_m[Triangulation.TIME_PENALTY] < 0.1 * error_m[Triangulation.CONVENTIONAL]).all()
    assert (error_m[Triangulation.INCREMENTAL] < 0.1 * error_m[Triangulation.CONVENTIONAL]).all()
