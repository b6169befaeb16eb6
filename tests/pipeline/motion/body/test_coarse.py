from collections import Counter

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.motion.body.coarse import coarsen
from pipeline.motion.body.makehuman import NUM_COARSE_TRIANGLES
from pipeline.motion.body.shape import BodyShapes, shape_body
from pipeline.motion.skeleton.model import INDEX
from tests.pipeline.motion.body.conftest import adult_lengths_m, in_pose
from tests.pipeline.motion.body.test_shape import volume_l


def tube(num_rings: int, num_spokes: int = 16) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of an open tube of radius 100 along z, rings of vertices 50 apart."""
    angles = np.linspace(0.0, 2.0 * np.pi, num_spokes, endpoint=False)
    rings = [
        np.column_stack([100 * np.cos(angles), 100 * np.sin(angles), np.full(num_spokes, 50 * ring)])
        for ring in range(num_rings)
    ]
    triangles = []
    for ring in range(num_rings - 1):
        for spoke in range(num_spokes):
            a, b = ring * num_spokes + spoke, ring * num_spokes + (spoke + 1) % num_spokes
            triangles += [(a, b, b + num_spokes), (a, b + num_spokes, a + num_spokes)]
    return np.rint(np.concatenate(rings)).astype(int), np.array(triangles)


def borders(triangles: np.ndarray) -> set[tuple[int, int]]:
    """Edges of one triangle alone."""
    edges = Counter(
        tuple(sorted((row[place], row[(place + 1) % 3]))) for row in triangles.tolist() for place in range(3)
    )
    assert max(edges.values()) <= 2
    return {edge for edge, number in edges.items() if number == 1}


def test_flat_surface_needs_few_triangles() -> None:
    points = np.array([(x, y, 0) for y in range(0, 900, 100) for x in range(0, 900, 100)])
    corners = np.array([9 * y + x for y in range(8) for x in range(8)])
    triangles = np.concatenate([corners[:, None] + [0, 1, 10], corners[:, None] + [0, 10, 9]])
    coarse = coarsen(points[None], triangles, 2)
    assert len(coarse) == 2
    assert set(coarse.ravel()) == {0, 8, 72, 80}
    first, second, third = np.moveaxis(points[coarse], 1, 0)
    assert np.cross(second - first, third - first)[:, 2].sum() == 2 * 800 * 800
    assert (np.cross(second - first, third - first)[:, 2] > 0).all()


def test_straight_tube_keeps_its_ends_and_bent_one_its_bend() -> None:
    points, triangles = tube(21)
    straight = coarsen(points[None], triangles, 40)
    assert len(straight) <= 40
    heights = points[np.unique(straight), 2]
    assert (heights == 0).sum() == (heights == 1000).sum() == 16
    assert len(heights) <= 32 + 4
    ends = borders(straight)
    assert {points[vertex, 2] for edge in ends for vertex in edge} == {0, 1000}
    # The second half is turned by a right angle in another pose.
    bent, bend = points.copy(), np.array([0, 0, 500])
    above = points[:, 2] > 500
    bent[above] = np.rint(bend + Rotation.from_euler("x", 90, degrees=True).apply(points[above] - bend))
    kept = np.unique(points[coarsen(np.array([points, bent]), triangles, 80).ravel(), 2])
    assert {500, 550} <= set(kept)


def test_as_many_triangles_as_wanted_are_left_alone() -> None:
    points, triangles = tube(3)
    np.testing.assert_array_equal(coarsen(points[None], triangles, len(triangles)), triangles)


def test_coarse_body_has_shape_of_body(shapes: BodyShapes) -> None:
    coarse = shapes.coarse()
    assert 0.9 * NUM_COARSE_TRIANGLES < len(coarse.triangles) <= NUM_COARSE_TRIANGLES
    assert not borders(coarse.triangles)
    quat = np.tile([0.0, 0.0, 0.0, 1.0], (64, 1))
    quat[[INDEX["LeftForeArm"], INDEX["RightLeg"]]] = Rotation.from_rotvec([[0, 0, -1.8], [1.8, 0, 0]]).as_quat()
    for stature_m in (0.9, 1.75):
        whole, few = (shape_body(of, adult_lengths_m(stature_m)) for of in (shapes, coarse))
        assert few.vertices_m[:, 2].min() == pytest.approx(whole.vertices_m[:, 2].min(), abs=0.005)
        assert np.ptp(few.vertices_m, axis=0) == pytest.approx(np.ptp(whole.vertices_m, axis=0), abs=0.01)
        volumes_l = [volume_l(in_pose(body, quat, body.joints_m[0])[0], body.triangles) for body in (whole, few)]
        # Triangles between vertices of a rounded surface lie inside of it.
        assert 0.95 * volumes_l[0] < volumes_l[1] < 1.01 * volumes_l[0]
