"""Deviations of bodies: steps against a dense solution of all unknowns, variances and delays that are recovered."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.calibration.adjustment.bundle import adjust
from pipeline.calibration.adjustment.deviations import Deviations, first_deviations
from pipeline.calibration.adjustment.normal import State, build, residuals_px
from pipeline.calibration.adjustment.parameters import EXTRINSICS, FOCAL, move_camera, no_prior, none_free
from pipeline.calibration.adjustment.problem import AdjustmentProblem, Loss, PointObservations, RigidBodies
from pipeline.geometry.camera import project
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras

CAMERAS = build_cameras(Rig(Layout.RING, 3, (3.0, 2.5), 2.0), np.random.default_rng(0))
GRID_M = np.stack([*np.meshgrid([-0.2, 0.0, 0.2], [-0.1, 0.1]), np.zeros((2, 3))], -1).reshape(-1, 3)


def bodies_of(number: int, rng: np.random.Generator) -> RigidBodies:
    turns = Rotation.from_rotvec(rng.normal(0.0, 0.8, (number, 3))).as_matrix()
    return RigidBodies(turns, rng.uniform([-0.8, -0.8, 0.4], [0.8, 0.8, 1.6], (number, 3)))


def observed(bodies: RigidBodies, total: np.ndarray, noise_px: float, rng: np.random.Generator) -> PointObservations:
    camera, block, point = (index.ravel() for index in np.indices((3, bodies.num_blocks, len(GRID_M))))
    points_px = np.empty((len(camera), 2))
    for number, one in enumerate(CAMERAS):
        rows = camera == number
        xyz_m, _ = bodies.moved(total[number]).in_world(block[rows], GRID_M[point[rows]])
        points_px[rows] = project(one, xyz_m)
    return PointObservations(camera, block, GRID_M[point], points_px + rng.normal(0.0, noise_px, points_px.shape))


def test_eliminated_deviations_take_step_of_whole_system() -> None:
    rng = np.random.default_rng(1)
    bodies = bodies_of(4, rng)
    free = none_free(3)
    free[1:, EXTRINSICS] = free[:, FOCAL] = True
    total = rng.normal(0.0, 0.003, (3, 4, 6))
    problem = AdjustmentProblem(CAMERAS, free, no_prior(3), observed(bodies, total, 0.3, rng), Loss.LINEAR)
    speed = rng.normal(0.0, 0.3, (4, 6))
    begin = Deviations(np.zeros((3, 4, 6)), np.array([0.01, 0.02]), np.array([1.0, 2.0, 0.5, 1.0]), speed,
                       np.zeros((3, 4)), np.zeros(3))  # fmt: skip
    state = State(CAMERAS, bodies, np.empty(0), begin)

    def residuals(x: np.ndarray) -> np.ndarray:
        of_cameras, delay_s = np.zeros(free.shape), np.zeros(3)
        of_cameras[free], delay_s[1:] = x[: free.sum()], x[free.sum() : free.sum() + 2]
        of_bodies, step = np.split(x[free.sum() + 2 :], [24])
        cameras = tuple(move_camera(camera, own) for camera, own in zip(CAMERAS, of_cameras, strict=True))
        deviations = replace(begin, step=step.reshape(3, 4, 6), delay_s=delay_s)
        moved = State(cameras, bodies.moved(of_bodies.reshape(4, 6)), np.empty(0), deviations)
        return np.concatenate([residuals_px(problem, moved).ravel() / 0.3, step / begin.sigma.ravel(), delay_s])

    expected = gauss_newton(residuals, free.sum() + 2 + 24 + 72)
    normal = build(problem, state, 0.3)
    step, of_bodies = normal.step(0.0)
    # The parameters of a camera come together, its delay at the end; here delays come after all cameras.
    ordered = np.concatenate([expected[:8], expected[15:16], expected[8:15], expected[16:17]])
    np.testing.assert_allclose(step, ordered, rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(of_bodies, expected[17:41], rtol=1e-3, atol=1e-6)
    deviations = normal.deviation_steps(step, of_bodies.reshape(4, 6))
    np.testing.assert_allclose(deviations.ravel(), expected[41:], rtol=1e-3, atol=1e-6)


def gauss_newton(residuals: Callable[[np.ndarray], np.ndarray], number: int) -> np.ndarray:
    """First step of Gauss and Newton from zero, with central differences."""
    columns = [(residuals(1e-6 * unit) - residuals(-1e-6 * unit)) / 2e-6 for unit in np.eye(number)]
    jacobian = np.column_stack(columns)
    return -np.linalg.solve(jacobian.T @ jacobian, jacobian.T @ residuals(np.zeros(number)))


@pytest.mark.slow
def test_variances_and_delays_are_those_of_views() -> None:
    rng = np.random.default_rng(2)
    bodies, delay_s = bodies_of(80, rng), np.array([0.0, 0.0, 0.05])
    speed = rng.normal(0.0, 0.4, (80, 6))
    sigma = np.repeat([0.004, 0.006], 3)
    total = rng.normal(0.0, sigma, (3, 80, 6)) + delay_s[:, None, None] * speed
    free = none_free(3)
    free[1:, EXTRINSICS] = free[:, FOCAL] = True
    problem = AdjustmentProblem(CAMERAS, free, no_prior(3), observed(bodies, total, 0.1, rng))
    found = adjust(problem, bodies, deviations=first_deviations(np.zeros((3, 80)), speed))
    assert found.deviations is not None
    np.testing.assert_allclose(found.deviations.delay_s, delay_s, atol=0.003)
    np.testing.assert_allclose(found.sigma_px, 0.1, rtol=0.15)
    # Student's t has a smaller scale than a normal distribution of the same spread.
    of_bodies = found.deviations.sigma[0].mean(0)
    np.testing.assert_allclose(of_bodies, sigma, rtol=0.25)
    for camera, truth in zip(found.cameras, CAMERAS, strict=True):
        assert abs(camera.matrix[0, 0] / truth.matrix[0, 0] - 1) < 0.003
    alone = adjust(problem, bodies)
    assert max(abs(c.matrix[0, 0] / t.matrix[0, 0] - 1) for c, t in zip(alone.cameras, CAMERAS, strict=True)) > 0.003
