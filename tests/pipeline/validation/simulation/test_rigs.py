"""Camera rigs: positions and views."""

import numpy as np
import pytest

from pipeline.geometry.camera import center_in_world, look_at, project
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras, choose_views

RIGS = {
    "ring": Rig(Layout.RING, 5, (4.0, 3.0), 2.0),
    "ceiling": Rig(Layout.CEILING, 12, (5.0, 4.0), 3.0),
    "dome": Rig(Layout.DOME, 31, (4.5, 4.5), 0.9),
}


@pytest.mark.parametrize("kind", RIGS)
def test_all_cameras_see_middle_upright(kind: str) -> None:
    cameras = build_cameras(RIGS[kind], np.random.default_rng(1))
    assert len({camera.name for camera in cameras}) == RIGS[kind].num_cameras
    for camera in cameras:
        rotation = camera.cam_from_world.rotation
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        low, high = project(camera, np.array([[0.0, 0.0, 0.8], [0.0, 0.0, 1.2]]))
        assert ((low > 0) & (low < camera.size_px)).all()
        assert high[1] < low[1]


def test_places() -> None:
    centers_m = {
        kind: np.array([center_in_world(camera) for camera in build_cameras(rig, np.random.default_rng(1))])
        for kind, rig in RIGS.items()
    }
    np.testing.assert_allclose(np.linalg.norm(centers_m["ring"][:, :2] / [4.0, 3.0], axis=1), 1.0, atol=0.03)
    np.testing.assert_allclose(centers_m["ceiling"][:, 2], 3.0, atol=0.06)
    np.testing.assert_allclose(np.linalg.norm(centers_m["dome"], axis=1), 4.5, atol=0.1)
    assert centers_m["dome"][:, 2].min() > 0.8
    assert centers_m["dome"][:, 2].max() > 3.5
    for one in centers_m.values():
        distance_m = np.linalg.norm(one[:, None] - one, axis=-1) + np.diag(np.full(len(one), np.inf))
        assert distance_m.min() > 0.5


def test_look_at_puts_target_on_axis() -> None:
    cam_from_world = look_at(np.array([3.0, -1.0, 2.0]), np.array([0.5, 0.5, 1.0]))
    x, y, z = cam_from_world.apply(np.array([0.5, 0.5, 1.0]))
    assert (x, y) == pytest.approx((0.0, 0.0), abs=1e-12)
    assert z == pytest.approx(np.sqrt(2.5**2 + 1.5**2 + 1.0))


@pytest.mark.parametrize(("num_cameras", "num_views"), [(4, 2), (4, 3), (4, 4), (31, 2), (31, 6), (31, 30), (3, 2)])
def test_chosen_views_differ_and_spread(num_cameras: int, num_views: int) -> None:
    chosen = choose_views(num_cameras, num_views)
    assert len(set(chosen)) == num_views
    assert 0 <= min(chosen) <= max(chosen) < num_cameras
    gaps = np.diff([*chosen, num_cameras + chosen[0]])
    assert gaps.max() <= (num_cameras if num_views == 2 else num_cameras // num_views + 1)


def test_two_views_stand_at_right_angle() -> None:
    assert choose_views(4, 2) == [0, 1]
    assert choose_views(12, 2) == [0, 3]
