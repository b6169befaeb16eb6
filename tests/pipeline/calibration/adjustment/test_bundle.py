"""Adjustment of cameras with points, bodies and links: recovery, robustness, standard deviations."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.calibration.adjustment.bundle import Adjustment, adjust, block_covariance
from pipeline.calibration.adjustment.parameters import (
    DISTORTION,
    EXTRINSICS,
    FOCAL,
    NUM_PARAMETERS,
    POSITION,
    PRINCIPAL,
    Free,
    move_camera,
    no_prior,
    none_free,
    offsets,
)
from pipeline.calibration.adjustment.problem import (
    AdjustmentProblem,
    DistanceLinks,
    FreePoints,
    Loss,
    PointObservations,
    RigidBodies,
    ShiftLinks,
    observations_of_points,
)
from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import project
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras
from tests.cases import slow_but

CAMERAS = build_cameras(Rig(Layout.RING, 4, (3.0, 2.5), 2.0), np.random.default_rng(0))
TRUTH_M = np.random.default_rng(1).uniform([-1.2, -1.2, 0.2], [1.2, 1.2, 1.8], (150, 3))
SIGMA_PX = 0.5


def gauge_fixed(*free: slice) -> Free:
    """Extrinsics but for the first camera's and one coordinate of the second one's, and more parameters of all."""
    mask = none_free(4)
    mask[1:, EXTRINSICS] = True
    mask[1, POSITION.start] = False
    for part in free:
        mask[:, part] = True
    return mask


def disturbed(free: Free, rng: np.random.Generator) -> tuple[Camera, ...]:
    steps = np.zeros((4, NUM_PARAMETERS))
    steps[:, :3], steps[:, 3:6] = rng.normal(0, 0.02, (4, 3)), rng.normal(0, 0.03, (4, 3))
    steps[:, FOCAL], steps[:, PRINCIPAL] = rng.normal(0, 0.03, (4, 1)), rng.normal(0, 8.0, (4, 2))
    return tuple(move_camera(camera, step) for camera, step in zip(CAMERAS, steps * free, strict=True))


def seen_px(rng: np.random.Generator, noise_px: float) -> np.ndarray:
    points_px = np.stack([project(camera, TRUTH_M) for camera in CAMERAS], axis=1)
    return points_px + rng.normal(0.0, noise_px, points_px.shape)


def solve(seed: int, noise_px: float, free: Free, outliers: int = 0, loss: Loss = Loss.CAUCHY) -> Adjustment:
    rng = np.random.default_rng(seed)
    points_px = seen_px(rng, noise_px)
    points_px.reshape(-1, 2)[rng.permutation(600)[:outliers]] += rng.normal(0.0, 60.0, (outliers, 2))
    points_px[:5, 2:] = np.nan
    begin = FreePoints(TRUTH_M + rng.normal(0.0, 0.02, TRUTH_M.shape))
    cameras = disturbed(free, rng)
    return adjust(AdjustmentProblem(cameras, free, no_prior(4), observations_of_points(points_px), loss), begin)


@pytest.mark.parametrize("loss", list(Loss))
def test_disturbed_rig_comes_back_exactly(loss: Loss) -> None:
    found = solve(2, 0.0, gauge_fixed(FOCAL, PRINCIPAL), loss=loss)
    np.testing.assert_allclose(offsets(CAMERAS, found.cameras), 0.0, atol=1e-5)
    assert np.abs(found.residuals_px).max() < 1e-3


@pytest.mark.parametrize(
    ("loss", "worst_deg"), slow_but([(Loss.CAUCHY, 0.08)], [(Loss.CAUCHY, 0.08), (Loss.HUBER, 0.3)])
)
def test_wrong_observations_hardly_pull(loss: Loss, worst_deg: float) -> None:
    found = solve(3, SIGMA_PX, gauge_fixed(), outliers=60, loss=loss)
    assert np.degrees(np.abs(offsets(CAMERAS, found.cameras)[:, :3]).max()) < worst_deg
    assert abs(found.sigma_px - SIGMA_PX) < (0.1 if loss is Loss.CAUCHY else 0.2)
    pulled = solve(3, SIGMA_PX, gauge_fixed(), outliers=60, loss=Loss.LINEAR)
    assert np.degrees(np.abs(offsets(CAMERAS, pulled.cameras)[:, :3]).max()) > worst_deg


@pytest.mark.slow
def test_standard_deviations_are_those_of_repeats() -> None:
    free = gauge_fixed(FOCAL)
    repeats = [solve(seed, SIGMA_PX, free, loss=Loss.LINEAR) for seed in range(10, 40)]
    spread = np.std([offsets(CAMERAS, one.cameras) for one in repeats], axis=0)
    stated = np.mean([one.sigma for one in repeats], axis=0)
    ratio = (spread / np.where(free, stated, 1.0))[free]
    assert 0.9 < np.median(ratio) < 1.1
    assert ratio.min() > 0.6
    assert ratio.max() < 1.6
    np.testing.assert_array_equal(stated[~free], 0.0)


@pytest.mark.slow
def test_covariances_of_blocks_are_those_of_repeats() -> None:
    free, chosen = gauge_fixed(FOCAL), np.array([20, 90])
    found, stated = [], []
    for seed in range(10, 40):
        rng = np.random.default_rng(seed)
        observations = observations_of_points(seen_px(rng, SIGMA_PX))
        problem = AdjustmentProblem(CAMERAS, free, no_prior(4), observations, Loss.LINEAR)
        adjusted = adjust(problem, FreePoints(TRUTH_M))
        assert isinstance(adjusted.structure, FreePoints)
        found.append((adjusted.structure.xyz_m - TRUTH_M)[chosen].ravel())
        stated.append(block_covariance(problem, adjusted, chosen))
    # Squares of the errors in units of the covariance are chi-squared with six degrees of freedom.
    squares = [error @ np.linalg.solve(covariance, error) for error, covariance in zip(found, stated, strict=True)]
    assert 4.5 < np.mean(squares) < 7.5


def test_undetermined_directions_have_infinite_deviations() -> None:
    free = none_free(4)
    free[:, EXTRINSICS] = True
    assert np.isinf(solve(4, SIGMA_PX, free).sigma[free]).all()


def test_prior_holds_what_observations_leave_open() -> None:
    free = none_free(4)
    free[:, EXTRINSICS] = True
    prior = no_prior(4)
    prior[:, EXTRINSICS] = 0.01
    rng = np.random.default_rng(5)
    problem = AdjustmentProblem(CAMERAS, free, prior, observations_of_points(seen_px(rng, SIGMA_PX)))
    found = adjust(problem, FreePoints(TRUTH_M))
    # Four cameras share the freedom of the world: a shift is known half as well as each prior says.
    assert found.sigma[:, POSITION].max() < 0.01
    assert np.abs(offsets(CAMERAS, found.cameras)).max() < 2e-3


def test_boards_determine_cameras_with_their_lenses() -> None:
    rng = np.random.default_rng(6)
    grid = np.stack([*np.meshgrid(np.arange(6) * 0.12, np.arange(4) * 0.12), np.zeros((4, 6))], -1).reshape(-1, 3)
    turns = Rotation.from_rotvec(rng.normal(0.0, 0.8, (40, 3))).as_matrix()
    boards = RigidBodies(turns, rng.uniform([-0.8, -0.8, 0.4], [0.8, 0.8, 1.6], (40, 3)))
    camera, block, corner = (index.ravel() for index in np.indices((4, 40, len(grid))))
    xyz_m, _ = boards.in_world(block, grid[corner])
    points_px = np.concatenate([project(one, xyz_m[camera == c]) for c, one in enumerate(CAMERAS)])
    points_px += rng.normal(0.0, 0.1, points_px.shape)
    free = none_free(4)
    free[1:, EXTRINSICS] = True
    free[:, FOCAL] = free[:, PRINCIPAL] = True
    free[:, DISTORTION.start : DISTORTION.start + 5] = True
    cameras = tuple(replace(one, distortion=np.zeros(5)) for one in disturbed(free, rng))
    begin = boards.moved(rng.normal(0.0, 0.01, (40, 6)))
    problem = AdjustmentProblem(cameras, free, no_prior(4), PointObservations(camera, block, grid[corner], points_px))
    found = adjust(problem, begin)
    error = offsets(CAMERAS, found.cameras)
    assert np.abs(error[:, FOCAL]).max() < 1e-3
    assert np.abs(error[:, POSITION]).max() < 2e-3
    assert np.abs(error[:, DISTORTION][:, 0]).max() < 0.01
    assert (np.abs(error) < 4.5 * found.sigma + 1e-12).all()
    assert abs(found.sigma_px - 0.1) < 0.01


def test_links_bring_scale_and_still_points_together() -> None:
    rng = np.random.default_rng(7)
    pairs = np.column_stack([np.arange(0, 150, 2), np.arange(1, 150, 2)])
    truth_m = TRUTH_M.copy()
    truth_m[1::2] = truth_m[::2] + 0.4 * np.array([0.0, 0.6, 0.8])
    points_px = np.stack([project(camera, truth_m) for camera in CAMERAS], axis=1)
    points_px += rng.normal(0.0, SIGMA_PX, points_px.shape)
    free = none_free(4)
    free[1:, EXTRINSICS] = True  # the length of the links brings the scale
    bones = DistanceLinks(pairs, np.zeros(75, int), np.full(75, 1e-3))
    problem = AdjustmentProblem(
        CAMERAS, free, no_prior(4), observations_of_points(points_px), Loss.CAUCHY, (bones,), np.array([0.5]),
        np.array([1e-6]),
    )  # fmt: skip
    found = adjust(problem, FreePoints(truth_m + rng.normal(0.0, 0.01, truth_m.shape)))
    # The world grows with the given length, about the first camera.
    centers_m = [
        one.cam_from_world.inverse().translation_m - cameras[0].cam_from_world.inverse().translation_m
        for cameras in (CAMERAS, found.cameras)
        for one in cameras[1:]
    ]
    ratio = np.linalg.norm(centers_m[3:], axis=-1) / np.linalg.norm(centers_m[:3], axis=-1)
    np.testing.assert_allclose(ratio, 0.5 / 0.4, rtol=2e-3)
    assert isinstance(found.structure, FreePoints)
    lengths_m = np.linalg.norm(found.structure.xyz_m[pairs[:, 0]] - found.structure.xyz_m[pairs[:, 1]], axis=-1)
    np.testing.assert_allclose(lengths_m, 0.5, atol=5e-3)
    still = adjust(
        replace(problem, free=none_free(4), links=(ShiftLinks(pairs, np.full(75, 1e-5)),)), FreePoints(truth_m)
    ).structure
    assert isinstance(still, FreePoints)
    assert np.linalg.norm(still.xyz_m[pairs[:, 0]] - still.xyz_m[pairs[:, 1]], axis=-1).max() < 5e-3


def test_lengths_of_links_are_estimated() -> None:
    pairs = np.array([[0, 1], [1, 2], [2, 3]])
    lengths_m = np.linalg.norm(TRUTH_M[pairs[:, 0]] - TRUTH_M[pairs[:, 1]], axis=-1)
    link = DistanceLinks(pairs, np.arange(3), np.full(3, 1e-3))
    problem = AdjustmentProblem(
        CAMERAS, none_free(4), no_prior(4), observations_of_points(seen_px(np.random.default_rng(8), 0.0)),
        links=(link,), lengths_m=np.ones(3), length_sigma_m=np.full(3, np.inf),
    )  # fmt: skip
    np.testing.assert_allclose(adjust(problem, FreePoints(TRUTH_M)).lengths_m, lengths_m, atol=1e-4)
