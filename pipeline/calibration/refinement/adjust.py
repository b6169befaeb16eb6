"""Adjustment of a calibration to sightings of people."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipeline.calibration.adjustment.adjust import Adjustment, adjust, sigma_in_held_world
from pipeline.calibration.adjustment.parameters import (
    FOCAL,
    POSITION,
    ROTATION,
    Free,
    move_camera,
    no_prior,
    offsets,
)
from pipeline.calibration.adjustment.problem import AdjustmentProblem, observations_of_points
from pipeline.calibration.adjustment.structure import FreePoints
from pipeline.calibration.refinement.sightings import JointSightings
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import project

PRIOR_SIGMA = ((ROTATION, np.radians(5.0)), (POSITION, 0.3), (FOCAL, 0.1))
"""Standard deviations of the parameters before anything is seen: a calibration is off by degrees at most."""

# Largest number of steps of a search, and steps that end it, as a share of the prior's standard deviations.
_MAX_STEPS, _SMALL_STEP = 15, 2e-4


def adjust_to_sightings(
    given: Sequence[Camera], start: Sequence[Camera], sightings: JointSightings, free: Free
) -> Adjustment:
    """Adjust cameras to sightings.

    Parameters
    ----------
    given
        Cameras as calibrated, means of the prior.
    start
        Cameras with which the search begins; parameters that may not change are taken from ``given``.
    free
        Parameters that may change: of rotations, positions and focal lengths.

    Returns
    -------
        Standard deviations hold the world's position, orientation and scale; deviations of ``PRIOR_SIGMA``
        where the sightings say nothing.
    """
    steps = offsets(given, start) * free
    start = tuple(move_camera(camera, step) for camera, step in zip(given, steps, strict=True))
    xyz_m = sightings.triangulated(start)
    # A view whose point is behind its camera is a mistake.
    is_behind = np.isnan(np.stack([project(camera, xyz_m) for camera in start], axis=1))
    points_px = np.where(is_behind, np.nan, sightings.points_px)
    is_known = np.isfinite(xyz_m).all(-1)
    prior_sigma = no_prior(len(given))
    for parameters, sigma in PRIOR_SIGMA:
        prior_sigma[:, parameters] = sigma
    problem = AdjustmentProblem(tuple(given), free, prior_sigma, observations_of_points(points_px[is_known]))
    points, small_step = FreePoints(read_only(xyz_m[is_known])), _SMALL_STEP * prior_sigma
    adjusted = adjust(problem, points, start, max_steps=_MAX_STEPS, small_step=small_step)
    return replace(adjusted, sigma=sigma_in_held_world(problem, adjusted))
