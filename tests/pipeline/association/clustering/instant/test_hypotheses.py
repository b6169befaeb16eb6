import numpy as np

from pipeline.association.clustering.instant.hypotheses import Candidates, meet, reprojection_px
from pipeline.association.clustering.instant.work_limits import WorkLimits
from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import image_from_world

POINTS_M = np.array([[0.1, 0.2, 1.0], [-0.4, 0.3, 1.4]])


def candidates_of(projections: np.ndarray, points_m: np.ndarray) -> Candidates:
    """Exact candidates of joint 0 in all views, point by point."""
    in_cam = np.einsum("cij,kj->cki", projections[:, :, :3], points_m) + projections[:, None, :, 3]
    num_views, num_points = in_cam.shape[:2]
    points_px = (in_cam[..., :2] / in_cam[..., 2:]).reshape(-1, 2)
    return Candidates(
        joint=np.zeros(num_views * num_points, int),
        view=np.repeat(np.arange(num_views), num_points),
        points_px=points_px,
        seen_px=points_px,
        score=np.full(num_views * num_points, 0.9),
        body=np.tile(np.arange(num_points), num_views),
    )


def test_every_pair_of_views_meets_at_points(ring: tuple[Camera, ...]) -> None:
    projections = np.array([image_from_world(camera) for camera in ring])
    candidates = candidates_of(projections, POINTS_M)
    hypotheses = meet(projections, candidates, 8.0, WorkLimits())
    for point, point_m in enumerate(POINTS_M):
        is_right = (candidates.body[hypotheses.pair] == point).all(-1)
        assert is_right.sum() == 6  # four views
        np.testing.assert_allclose(hypotheses.xyz_m[is_right], np.tile(point_m, (6, 1)), atol=1e-9)
    assert (candidates.view[hypotheses.pair[:, 0]] < candidates.view[hypotheses.pair[:, 1]]).all()


def test_joints_of_different_kinds_never_meet(ring: tuple[Camera, ...]) -> None:
    projections = np.array([image_from_world(camera) for camera in ring])
    candidates = candidates_of(projections, POINTS_M[:1])._replace(joint=np.arange(4))
    assert len(meet(projections, candidates, 8.0, WorkLimits()).pair) == 0


def test_hypothesis_fits_both_views_within_tau1(ring: tuple[Camera, ...]) -> None:
    projections = np.array([image_from_world(camera) for camera in ring])
    candidates = candidates_of(projections, POINTS_M)
    shifted = candidates._replace(points_px=candidates.points_px + np.where(candidates.view == 0, 30.0, 0.0)[:, None])
    found = meet(projections, shifted, 8.0, WorkLimits())
    errors_px = reprojection_px(
        projections[shifted.view[found.pair]], np.repeat(found.xyz_m[:, None], 2, 1), shifted.points_px[found.pair]
    )
    assert len(found.pair)
    assert errors_px.max() <= 8.0
    assert len(meet(projections, shifted, 100.0, WorkLimits()).pair) > len(found.pair)


def test_points_behind_camera_have_no_reprojection(ring: tuple[Camera, ...]) -> None:
    projection = image_from_world(ring[0])
    behind_m = np.array([12.0, 2.0, 2.0])
    assert reprojection_px(projection, behind_m, np.zeros(2)) == np.inf
    assert reprojection_px(projection, np.full(3, np.nan), np.zeros(2)) == np.inf
