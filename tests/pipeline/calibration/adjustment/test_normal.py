"""Steps of the normal equations, against a dense solution of all unknowns at once."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from pipeline.calibration.adjustment.normal import State, build
from pipeline.calibration.adjustment.parameters import EXTRINSICS, no_prior, none_free
from pipeline.calibration.adjustment.problem import (
    AdjustmentProblem,
    DistanceLinks,
    FreePoints,
    ShiftLinks,
    observations_of_points,
)
from pipeline.geometry.camera import project
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras

CAMERAS = build_cameras(Rig(Layout.RING, 3, (3.0, 2.5), 2.0), np.random.default_rng(0))


@pytest.mark.parametrize("has_links", [False, True])
def test_eliminated_unknowns_take_step_of_whole_system(has_links: bool) -> None:
    rng = np.random.default_rng(1)
    truth_m = rng.uniform([-1.2, -1.2, 0.2], [1.2, 1.2, 1.8], (20, 3))
    points_px = np.stack([project(camera, truth_m) for camera in CAMERAS], axis=1) + rng.normal(0.0, 1.0, (20, 3, 2))
    free, sigma = none_free(3), no_prior(3)
    free[1:, EXTRINSICS] = True
    sigma[1:, EXTRINSICS] = 0.1
    pairs = np.array([[0, 1], [2, 3], [4, 5]])
    links = (DistanceLinks(pairs, np.array([0, 0, 1]), np.full(3, 0.02)), ShiftLinks(pairs + 6, np.full(3, 0.05)))
    lengths_m = np.array([0.5, 0.4]) if has_links else np.empty(0)
    problem = AdjustmentProblem(
        CAMERAS, free, sigma, observations_of_points(points_px), links=links if has_links else (),
        lengths_m=lengths_m, length_sigma_m=np.full(len(lengths_m), 0.3),
    )  # fmt: skip
    state = State(CAMERAS, FreePoints(truth_m + rng.normal(0.0, 0.05, truth_m.shape)), lengths_m + 0.1)
    normal = build(problem, state, 1.0)
    lower = block_diag(*normal.blocks, np.zeros((len(lengths_m),) * 2))
    if normal.coupling is not None:
        lower += normal.coupling.toarray()
    whole = np.block([[normal.cameras, normal.mixed.T], [normal.mixed, lower]])
    damping = 0.1
    whole += damping * np.diag(np.diag(whole))
    expected = -np.linalg.solve(whole, np.concatenate([normal.cameras_right, normal.right]))
    step, eliminated = normal.step(damping)
    np.testing.assert_allclose(np.concatenate([step, eliminated]), expected, rtol=1e-6, atol=1e-9)
