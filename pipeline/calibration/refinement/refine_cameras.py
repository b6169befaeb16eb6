"""Refine a given calibration: rotations, positions and focal lengths, as far as there is evidence in the sightings."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pipeline.calibration.adjustment.bundle import Adjustment, adjust
from pipeline.calibration.adjustment.parameters import (
    FOCAL,
    POSITION,
    ROTATION,
    move_camera,
    no_prior,
    none_free,
)
from pipeline.calibration.adjustment.problem import AdjustmentProblem, FreePoints, observations_of_points
from pipeline.calibration.refinement.bumps import Step, find_steps
from pipeline.calibration.refinement.evidence import weigh_evidence
from pipeline.calibration.refinement.sightings import JointSightings
from pipeline.calibration.similarity import shift_m, turn_deg
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, CameraMove, Refusal
from pipeline.geometry.camera import project

PRIOR_SIGMA = ((ROTATION, np.radians(5.0)), (POSITION, 0.3), (FOCAL, 0.1))
"""Standard deviations of the parameters before anything is seen: a calibration is off by degrees at most."""

# Largest number of steps of a search, and steps that end it, as a share of the prior's standard deviations.
_MAX_STEPS, _SMALL_STEP = 15, 2e-4


class SightingsFit(NamedTuple):
    """Cameras that were adjusted to sightings."""

    problem: AdjustmentProblem
    adjusted: Adjustment
    sightings: JointSightings  # Sightings of the points that were adjusted


def adjust_to_sightings(given: Sequence[Camera], start: Sequence[Camera], sightings: JointSightings) -> SightingsFit:
    """Adjust rotations, positions and focal lengths to sightings.

    ``given``: cameras as calibrated, means of the prior. ``start``: cameras with which the search begins.
    """
    xyz_m = sightings.triangulated(start)
    # A view whose point is behind its camera is a mistake.
    is_behind = np.isnan(np.stack([project(camera, xyz_m) for camera in start], axis=1))
    points_px = np.where(is_behind, np.nan, sightings.points_px)
    is_known = np.isfinite(xyz_m).all(-1)
    free, prior_sigma = none_free(len(given)), no_prior(len(given))
    for parameters, sigma in PRIOR_SIGMA:
        free[:, parameters], prior_sigma[:, parameters] = True, sigma
    problem = AdjustmentProblem(tuple(given), free, prior_sigma, observations_of_points(points_px[is_known]))
    points, small_step = FreePoints(read_only(xyz_m[is_known])), _SMALL_STEP * prior_sigma
    adjusted = adjust(problem, points, tuple(start), max_steps=_MAX_STEPS, small_step=small_step)
    return SightingsFit(problem, adjusted, sightings.subset(is_known))


_MIN_POINTS = 60
# Errors are clipped at so many medians where cameras are compared: their mean tells more than their median.
_CLIP = 5.0
# Least share by which the other views' error falls if cameras are fitted without the shorter part of a moved camera's.
_MIN_GAIN_OF_STEP = 0.02
_DECIMALS = 7


@dataclass(frozen=True, slots=True, eq=False)
class RefinedCameras:
    """Result of a refinement."""

    cameras: tuple[Camera, ...]  # Refined cameras in the given world; the given ones if there is a refusal
    refusal: Refusal | None  # Reason to keep the given cameras; ``None``: the cameras are refined ones
    # Moves from the given cameras to the expected ones, refused or not, of the cameras that see people; the largest
    # move in a camera's own picture first. Empty if the people determine no camera.
    moves: tuple[CameraMove, ...]
    # Median reprojection error of the given and of the expected cameras; NaN without sightings
    error_before_px: float
    error_after_px: float
    steps: tuple[Step, ...]  # Cameras that were moved in the middle of the take
    num_points: int  # Number of points

    @property
    def is_refined(self) -> bool:
        """True if the cameras are refined ones."""
        return self.refusal is None


def refine(given: Sequence[Camera], start: Sequence[Camera], sightings: JointSightings) -> RefinedCameras:
    """Refine cameras from sightings of people.

    Cameras move if there is evidence that the given ones are off, each to its expected place. ``given`` are the
    cameras as calibrated. The search begins with ``start``: the given ones, or an earlier refinement's.
    """
    unchanged = RefinedCameras(tuple(given), "few_people", (), np.nan, np.nan, (), len(sightings))
    if len(sightings) < _MIN_POINTS:
        return unchanged
    fit, steps, kept = _without_steps(given, start, sightings)
    evidence = weigh_evidence(*fit)
    # The last digits depend on the number of threads of the linear algebra.
    moved = np.round(evidence.steps, _DECIMALS)
    cameras = tuple(move_camera(camera, step) for camera, step in zip(given, moved, strict=True))
    before_px, after_px = (_median(_errors_px(some, kept)) for some in (given, cameras))
    unchanged = replace(unchanged, error_before_px=before_px, error_after_px=after_px, steps=steps)
    if not evidence.is_off and not evidence.is_determined:
        return replace(unchanged, refusal="undetermined")
    unchanged = replace(unchanged, refusal="no_better", moves=_moves(given, cameras, kept))
    return replace(unchanged, cameras=cameras, refusal=None) if evidence.is_off else unchanged


def _moves(given: Sequence[Camera], fitted: Sequence[Camera], sightings: JointSightings) -> tuple[CameraMove, ...]:
    """Moves of the cameras that see people, by the distance at which these move in each camera's picture."""
    xyz_m = sightings.triangulated(fitted)
    is_seen = np.isfinite(sightings.points_px).all(-1)
    moves = []
    for then, now, seen in zip(given, fitted, is_seen.T, strict=True):
        moved_px = np.linalg.norm(project(now, xyz_m[seen]) - project(then, xyz_m[seen]), axis=-1)
        if len(moved_px := moved_px[np.isfinite(moved_px)]):
            focal_ratio = float(now.matrix[0, 0] / then.matrix[0, 0])
            moves.append(CameraMove(now.name, turn_deg(then, now), shift_m(then, now), focal_ratio, _median(moved_px)))
    return tuple(sorted(moves, key=lambda move: -move.moved_px))


def _without_steps(
    given: Sequence[Camera], start: Sequence[Camera], sightings: JointSightings
) -> tuple[SightingsFit, tuple[Step, ...], JointSightings]:
    """Fit of the cameras, cameras that were moved in the take, and the sightings without the shorter parts of these.

    A camera that was moved spoils the others. Of all steps that seem possible, the step is true without whose shorter
    part the cameras fit the rest of the take best.
    """
    fit = adjust_to_sightings(given, start, sightings)
    steps: list[Step] = []
    while True:
        best, cameras = None, fit.adjusted.cameras
        largest_gain = _MIN_GAIN_OF_STEP
        limit_px = _CLIP * _median(_errors_px(cameras, sightings))
        for step in find_steps(cameras, sightings):
            if step.camera in {other.camera for other in steps}:
                continue
            kept = sightings.without(step.hidden(sightings))
            fitted = adjust_to_sightings(given, cameras, kept)
            before_px, after_px = (
                float(np.minimum(_errors_px(some, kept), limit_px).mean())
                for some in (cameras, fitted.adjusted.cameras)
            )
            if (gain := 1.0 - after_px / before_px) > largest_gain:
                best, largest_gain = (step, kept, fitted), gain
        if best is None:
            return fit, tuple(steps), sightings
        step, kept, fit = best
        cameras = fit.adjusted.cameras
        again = (other for other in find_steps(cameras, sightings) if other.camera == step.camera)
        steps.append(next(again, step))
        sightings = kept


def _errors_px(cameras: Sequence[Camera], sightings: JointSightings) -> Float[np.ndarray, " views"]:
    """Distance of each view from the projection of its triangulated point; infinite where there is no projection."""
    xyz_m = sightings.triangulated(cameras)
    projected_px = np.stack([project(camera, xyz_m) for camera in cameras], axis=1)
    error_px = np.linalg.norm(projected_px - sightings.points_px, axis=-1)
    error_px[np.isnan(error_px)] = np.inf
    return error_px[np.isfinite(sightings.points_px).all(-1)]


def _median(errors_px: Float[np.ndarray, " views"]) -> float:
    return float(np.median(errors_px)) if len(errors_px) else np.nan
