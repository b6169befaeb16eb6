"""Triangulation of many instants: whatever kind of array comes in, no kernel is compiled again."""

import numpy as np
import pytest

from pipeline.geometry.camera_kernels import reproject_all
from pipeline.geometry.kernels import BLOCK_JOINTS, triangulate_all
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


@pytest.mark.parametrize("num_joints", [1, 17, BLOCK_JOINTS, BLOCK_JOINTS + 1, 2 * BLOCK_JOINTS + 7])
def test_each_joint_is_computed_as_if_it_were_alone(num_joints: int) -> None:
    rng = np.random.default_rng(num_joints)
    matrices, points_px = rng.normal(size=(4, 3, 4)), rng.uniform(0.0, 100.0, (6, 4, num_joints, 2))
    points_px[rng.random((6, 4, num_joints)) < 0.3] = np.nan
    weights, xyz_m = rng.uniform(0.0, 1.0, (6, 4, num_joints)), rng.normal(size=(6, num_joints, 3))
    cameras = [camera([0.0] * 5)] * 4

    def computed(joints: slice) -> list[np.ndarray]:
        seen = points_px[:, :, joints], weights[:, :, joints]
        return [triangulate_frames(matrices, *seen, 0.3), *reproject(cameras, xyz_m[:, joints], *seen, 0.3)]

    alone = [computed(slice(k, k + 1)) for k in range(num_joints)]
    together = computed(slice(None))
    assert np.isfinite(together[0]).any()
    assert np.isfinite(together[1]).any()
    for number, values in enumerate(together):
        np.testing.assert_array_equal(values, np.concatenate([parts[number] for parts in alone], axis=1))
