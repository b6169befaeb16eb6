"""Standard deviations of cameras from observations with lasting errors, against the errors of repeats."""

import numpy as np
import pytest

from pipeline.calibration.adjustment.bundle import Adjustment, adjust
from pipeline.calibration.adjustment.parameters import (
    EXTRINSICS,
    FOCAL,
    POSITION,
    ROTATION,
    Parameters,
    no_prior,
    none_free,
)
from pipeline.calibration.adjustment.problem import AdjustmentProblem, FreePoints, Loss, observations_of_points
from pipeline.calibration.people.people_adjustment import correlated_sigma
from pipeline.calibration.similarity import align_world, shift_m, turn_deg
from pipeline.core.data.arrays import read_only
from pipeline.geometry.camera import project
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras

NUM_SUBJECTS, NUM_INSTANTS = 30, 8


def adjusted(
    seed: int, lasting_px: float, num_cameras: int = 4
) -> tuple[Adjustment, Parameters, np.ndarray, np.ndarray]:
    """Adjust cameras to points that hardly move, seen with errors of which a part lasts.

    Returns the adjustment, the standard deviations, and the errors of places in millimetres and of rotations in degrees
    after an alignment.
    """
    rng = np.random.default_rng(seed)
    rig = build_cameras(Rig(Layout.RING, num_cameras, (4.0, 4.0), 2.2, distortion=(0.0,) * 5), np.random.default_rng(1))
    subjects_m = rng.uniform([-1.2, -1.2, 0.0], [1.2, 1.2, 1.8], (NUM_SUBJECTS, 3))
    xyz_m = (subjects_m[:, None] + rng.normal(0, 0.03, (NUM_SUBJECTS, NUM_INSTANTS, 3))).reshape(-1, 3)
    subject = np.repeat(np.arange(NUM_SUBJECTS), NUM_INSTANTS)
    points_px = np.stack([project(camera, xyz_m) for camera in rig], axis=1)
    points_px += rng.normal(0, 1.0, points_px.shape)
    points_px += rng.normal(0, max(lasting_px, 1e-9), (NUM_SUBJECTS, num_cameras, 2))[subject]
    free = none_free(num_cameras)
    free[1:, EXTRINSICS] = True
    free[1, POSITION.start] = False
    problem = AdjustmentProblem(rig, free, no_prior(num_cameras), observations_of_points(points_px), Loss.CAUCHY)
    made = adjust(problem, FreePoints(read_only(xyz_m)), max_steps=20)
    sigma = correlated_sigma(problem, made, [subject[problem.observations.block]])
    aligned = align_world(rig, made.cameras)
    errors_mm = np.array([1000 * shift_m(*pair) for pair in zip(rig, aligned, strict=True)])
    errors_deg = np.array([turn_deg(*pair) for pair in zip(rig, aligned, strict=True)])
    return made, sigma, errors_mm, errors_deg


@pytest.mark.slow
@pytest.mark.parametrize("lasting_px", [0.0, 3.0])
def test_errors_are_within_two_standard_deviations(lasting_px: float) -> None:
    shares, ratios, naive = [], [], []
    for seed in range(8):
        made, sigma, errors_mm, errors_deg = adjusted(seed, lasting_px)
        of_places_mm = 1000 * np.linalg.norm(sigma[:, POSITION], axis=1)
        of_turns_deg = np.degrees(np.linalg.norm(sigma[:, ROTATION], axis=1))
        shares += [*(errors_mm <= 2 * of_places_mm), *(errors_deg <= 2 * of_turns_deg)]
        ratios += [*(errors_mm / of_places_mm)]
        naive += [*(errors_mm <= 2000 * np.linalg.norm(made.sigma[:, POSITION], axis=1))[1:]]
    assert np.mean(shares) >= 0.9
    # They are not far too large.
    assert np.sqrt(np.mean(np.square(ratios))) > 0.35
    if lasting_px:
        # As if all errors were independent, too many are beyond.
        assert np.mean(naive) < 0.85


def test_lasting_errors_count_more_longer_they_last() -> None:
    _, brief, _, _ = adjusted(0, 0.0)
    _, lasting, _, _ = adjusted(0, 3.0)
    assert (lasting[:, POSITION] > 4 * brief[:, POSITION]).all()


def test_given_value_has_no_guess() -> None:
    _, sigma, _, _ = adjusted(0, 1.0)
    assert (sigma[:, FOCAL.start :] == 0.0).all()
    # The first camera, whose pose stayed, is as uncertain as the others in the world that these hold.
    assert sigma[0, POSITION].max() > 0.2 * sigma[2, POSITION].max()


def test_two_cameras_hold_world_together() -> None:
    _, sigma, _, _ = adjusted(0, 1.0, num_cameras=2)
    assert np.isfinite(sigma).all()
    assert (sigma[:, ROTATION].max(1) > 0).all()
