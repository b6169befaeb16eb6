"""Triangulation of many instants: whatever kind of array comes in, no kernel is compiled anew."""

import numpy as np
import pytest

from pipeline.geometry.camera_kernels import reproject_all
from pipeline.geometry.kernels import triangulate_all
from pipeline.geometry.tracks import reproject, triangulate_frames
from tests.pipeline.geometry.test_camera import camera


@pytest.mark.parametrize("kind", ["read-only", "with steps"])
def test_other_arrays_compile_no_kernel_and_change_nothing(kind: str) -> None:
    rng = np.random.default_rng(1)
    matrices, points_px = rng.normal(size=(3, 3, 4)), rng.uniform(0.0, 100.0, (5, 3, 17, 2))
    weights, xyz_m = np.ones((5, 3, 17)), rng.normal(size=(5, 17, 3))

    def computed(*arrays: np.ndarray) -> list[np.ndarray]:
        points, factors, places = arrays
        return [
            triangulate_frames(matrices, points, factors),
            *reproject([camera([0.0] * 5)] * 3, places, points, factors),
        ]

    def other(array: np.ndarray) -> np.ndarray:
        if kind == "with steps":
            return np.repeat(array, 2, axis=0)[::2]
        view = array.view()
        view.flags.writeable = False
        return view

    expected = computed(points_px, weights, xyz_m)
    compiled = len(triangulate_all.signatures), len(reproject_all.signatures)
    found = computed(*map(other, (points_px, weights, xyz_m)))
    assert (len(triangulate_all.signatures), len(reproject_all.signatures)) == compiled
    for one, two in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, two)
