"""Euler angles: all frames at once as one after the other, gimbal lock, and the matrices of angles."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.export.writers.euler import ORDERS, euler_deg, turned


def turning(num_frames: int, num_joints: int, step_rad: float) -> np.ndarray:
    """Rotations of joints that turn about axes that change."""
    rng = np.random.default_rng(5)
    steps = Rotation.from_rotvec(rng.normal(size=(num_frames * num_joints, 3)) * step_rad).as_matrix()
    steps = steps.reshape(num_frames, num_joints, 3, 3)
    found = np.empty_like(steps)
    now = Rotation.random(num_joints, random_state=3).as_matrix()
    for frame, step in enumerate(steps):
        found[frame] = now = step @ now
    return found


@pytest.mark.parametrize("step_rad", [0.05, 2.0])
def test_all_frames_at_once_are_as_one_after_other(step_rad: float) -> None:
    rotations = turning(300, 12, step_rad)
    # One joint passes through gimbal lock.
    quarter = np.linspace(0.0, 180.0, 300)
    quarter[150] = 90.0
    rotations[:, 0] = Rotation.from_euler("ZXY", np.column_stack([quarter, quarter, 0 * quarter]), True).as_matrix()
    orders = ["ZXY", *(ORDERS[place % len(ORDERS)] for place in range(11))]
    before_deg = np.random.default_rng(1).normal(size=(12, 3)) * 300.0
    at_once_deg = euler_deg(rotations, orders, before_deg)
    one_by_one_deg = []
    for frame in range(300):
        before_deg = euler_deg(rotations[frame : frame + 1], orders, before_deg)[0]
        one_by_one_deg.append(before_deg)
    np.testing.assert_allclose(at_once_deg, one_by_one_deg, atol=1e-9)
    for joint, order in enumerate(orders):
        matrices = Rotation.from_euler(order, at_once_deg[:, joint], degrees=True).as_matrix()
        np.testing.assert_allclose(matrices, rotations[:, joint], atol=1e-9)
    if step_rad < 1.0:
        # Angles leave one turn rather than jump, but for joints near gimbal lock.
        steps_deg = np.abs(np.diff(at_once_deg[:, 1:], axis=0)).max(-1)
        assert np.median(steps_deg) < 10.0
        assert np.abs(at_once_deg).max() > 180.0


@pytest.mark.parametrize("order", ORDERS)
def test_matrices_of_angles(order: str) -> None:
    angles_deg = np.random.default_rng(2).normal(size=(5, 4, 3)) * 200.0
    expected = Rotation.from_euler(order, angles_deg.reshape(-1, 3), degrees=True).as_matrix()
    np.testing.assert_allclose(turned(angles_deg, order).reshape(-1, 3, 3), expected, atol=1e-12)
