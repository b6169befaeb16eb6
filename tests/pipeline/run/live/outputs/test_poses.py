"""Poses in the forms of other systems, against SciPy's rotations and the skeleton's own kinematics."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import SkeletonMotion
from pipeline.motion.skeleton.model import WHOLE_SKELETON, forward_kinematics
from pipeline.run.live.outputs.poses import (
    FACING_X,
    FACING_Y,
    in_segments,
    product,
    rest_joints_m,
    world_rotations,
)
from tests.pipeline.run.live.outputs.people import NUM_BONES, live_skeleton, world_matrices


def test_product_turns_by_second_then_first() -> None:
    rng = np.random.default_rng(1)
    first, second = Rotation.random(20, rng=rng), Rotation.random(20, rng=rng)
    turned = Rotation.from_quat(product(first.as_quat(), second.as_quat()))
    np.testing.assert_allclose(turned.as_matrix(), (first * second).as_matrix(), atol=1e-12)


@pytest.mark.parametrize("num_joints", [NUM_BONES, len(WHOLE_SKELETON)])
def test_world_rotations_follow_chain_of_parents(num_joints: int) -> None:
    skeletons = [live_skeleton(seed, num_joints) for seed in range(3)]
    for skeleton, turns in zip(skeletons, world_rotations(skeletons), strict=True):
        np.testing.assert_allclose(Rotation.from_quat(turns).as_matrix(), world_matrices(skeleton), atol=1e-9)


@pytest.mark.parametrize(
    ("facing", "ahead", "left"), [(FACING_X, [1, 0, 0], [0, 1, 0]), (FACING_Y, [0, 1, 0], [-1, 0, 0])]
)
def test_segments_of_rest_pose_face_ahead(facing: np.ndarray, ahead: list[int], left: list[int]) -> None:
    """The rest pose faces -Y, with the left side at +X."""
    vectors = in_segments(np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), facing)
    np.testing.assert_allclose(vectors, [ahead, left, [0, 0, 1]], atol=1e-12)
    np.testing.assert_allclose(Rotation.from_quat(facing).apply(vectors)[0], [0, -1, 0], atol=1e-12)


def test_rest_joints_stand_on_floor_at_bone_lengths() -> None:
    lengths_m = live_skeleton(4).bone_length_m
    turns = np.tile([0.0, 0.0, 0.0, 1.0], (1, NUM_BONES, 1))
    expected_m = forward_kinematics(SkeletonMotion(1, "", 0, 25.0, lengths_m, np.zeros((1, 3)), turns, ()))[0]
    joints_m = rest_joints_m(lengths_m)
    np.testing.assert_allclose(joints_m - joints_m[0], expected_m, atol=1e-12)
    assert joints_m[:, 2].min() == pytest.approx(0.0)
