"""Refine a given calibration: rotations, then positions, then focal lengths, as far as the sightings determine them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from pipeline.calibration.adjustment.bundle import Adjustment, adjust, sigma_in_held_world
from pipeline.calibration.adjustment.parameters import (
    EXTRINSICS,
    FOCAL,
    POSITION,
    ROTATION,
    Free,
    move_camera,
    no_prior,
    none_free,
    offsets,
)
from pipeline.calibration.adjustment.problem import AdjustmentProblem, FreePoints, observations_of_points
from pipeline.calibration.refinement.bumps import Step, find_steps
from pipeline.calibration.refinement.sightings import JointSightings
from pipeline.calibration.similarity import align_world, shift_m, turn_deg
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, CameraMove, Refusal
from pipeline.geometry.camera import project

PRIOR_SIGMA = ((ROTATION, np.radians(5.0)), (POSITION, 0.3), (FOCAL, 0.1))
"""Standard deviations of the parameters before anything is seen: a calibration is off by degrees at most."""

# Largest number of steps of a search, and steps that end it, as a share of the prior's standard deviations.
_MAX_STEPS, _SMALL_STEP = 15, 2e-4


def adjust_to_sightings(
    given: Sequence[Camera], start: Sequence[Camera], sightings: JointSightings, free: Free
) -> Adjustment:
    """Adjust cameras to sightings.

    ``given``: cameras as calibrated, means of the prior. ``start``: cameras with which the search begins; parameters
    that may not change are taken from ``given``. ``free``: parameters that may change: of rotations, positions and
    focal lengths. Returns standard deviations; they hold the world's position, orientation and scale; deviations of
    ``PRIOR_SIGMA`` where the sightings say nothing.
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


MAX_ERROR_SHARE = 0.75
"""Largest share of the given cameras' error that refined cameras may leave; else the given ones are kept."""

_MIN_POINTS = 60
# Points from which parameters are chosen and bumps are found; all points give the final cameras.
_NUM_FOR_CHOICES = 3000
# Groups of parameters, and the share by which the cross-validated error has to fall for the last group to be freed.
# Focal lengths need more: they move cameras along their axes by centimetres.
_LEVELS = (((ROTATION,), 0.0), ((ROTATION, POSITION), 0.0), ((ROTATION, POSITION, FOCAL), 0.005))
_ERROR_LASTS_S = 0.2
# Errors are clipped at so many medians where levels are compared: their mean tells more than their median.
_CLIP = 5.0
# Least share by which the other views' error falls if cameras are fitted without the shorter part of a moved camera's.
_MIN_GAIN_OF_STEP = 0.02
# Largest standard deviation of a parameter that is freed.
_MAX_SIGMA = ((ROTATION, np.radians(0.25)), (POSITION, 0.03), (FOCAL, 0.01))
_DECIMALS = 7
_BLOCK_S, _MIN_BLOCKS = 2.0, 8


@dataclass(frozen=True, slots=True, eq=False)
class RefinedCameras:
    """Result of a refinement."""

    cameras: tuple[Camera, ...]  # Refined cameras in the given world; the given ones if there is a refusal
    refusal: Refusal | None  # Reason to keep the given cameras; ``None``: the cameras are refined ones
    # Moves from the given cameras to the cameras that fit the people best, refused or not, of the cameras that see
    # people; the largest move in a camera's own picture first. Empty if the people don't tell.
    moves: tuple[CameraMove, ...]
    # Median reprojection error of the given and of the refined cameras, cross-validated; NaN without sightings
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

    Fitted cameras are taken if the cross-validated reprojection error falls by more than a quarter. The world stays:
    most cameras are as close to their given poses as the sightings allow. ``given`` are the cameras as calibrated. The
    search begins with ``start``: the given ones, or an earlier refinement's.
    """
    unchanged = RefinedCameras(tuple(given), "few_people", (), np.nan, np.nan, (), len(sightings))
    if len(sightings) < _MIN_POINTS:
        return unchanged
    fitted, steps, kept = _without_steps(given, start, sightings.thinned(_NUM_FOR_CHOICES))
    error_before_px = _median(_errors_px(given, kept))
    best, error_px = _choose_level(given, fitted, kept, error_before_px)
    unchanged = replace(
        unchanged, refusal="undetermined", error_before_px=error_before_px, error_after_px=error_px, steps=steps
    )
    if best is None:
        return unchanged
    is_better = error_px <= MAX_ERROR_SHARE * error_before_px
    # The choice's points suffice to tell which camera would move.
    if is_better:
        for step in steps:
            sightings = sightings.without(step.hidden(sightings))
    else:
        sightings = kept
    cameras = adjust_to_sightings(given, fitted, sightings, best).cameras
    if best[:, EXTRINSICS].all():
        cameras = align_world(given, cameras)
    # The last digits depend on the number of threads of the linear algebra.
    steps_of_cameras = np.round(offsets(given, cameras), _DECIMALS)
    cameras = tuple(move_camera(camera, step) for camera, step in zip(given, steps_of_cameras, strict=True))
    moves = _moves(given, cameras, sightings)
    if not is_better:
        return replace(unchanged, refusal="no_better", moves=moves)
    return replace(unchanged, cameras=cameras, refusal=None, moves=moves)


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
) -> tuple[tuple[Camera, ...], tuple[Step, ...], JointSightings]:
    """Cameras that fit the take, the cameras that were moved, and the sightings without the shorter parts of these.

    A camera that was moved spoils the others. Of all steps that seem possible, the step is true without whose shorter
    part the cameras fit the rest of the take best.
    """
    free = _free(len(given), (ROTATION, POSITION))
    cameras = adjust_to_sightings(given, start, sightings, free).cameras
    steps: list[Step] = []
    while True:
        best = None
        largest_gain = _MIN_GAIN_OF_STEP
        limit_px = _CLIP * _median(_errors_px(cameras, sightings))
        for step in find_steps(cameras, sightings):
            if step.camera in {other.camera for other in steps}:
                continue
            kept = sightings.without(step.hidden(sightings))
            fitted = adjust_to_sightings(given, cameras, kept, free).cameras
            before_px, after_px = (
                float(np.minimum(_errors_px(some, kept), limit_px).mean()) for some in (cameras, fitted)
            )
            if (gain := 1.0 - after_px / before_px) > largest_gain:
                best, largest_gain = (step, kept, fitted), gain
        if best is None:
            return cameras, tuple(steps), sightings
        step, kept, cameras = best
        again = (other for other in find_steps(cameras, sightings) if other.camera == step.camera)
        steps.append(next(again, step))
        sightings = kept


def _choose_level(
    given: Sequence[Camera], start: Sequence[Camera], sightings: JointSightings, error_before_px: float
) -> tuple[Free | None, float]:
    """Choose the free parameters by cross-validation over time; ``None``: the sightings determine no parameter."""
    error_px = error_before_px
    best = None
    clipped_px = np.inf
    for level, min_gain in _LEVELS:
        free = _determined(given, start, sightings, _free(len(given), level))
        if not free.any():
            continue
        errors_px = _cross_validated_px(given, start, sightings, free)
        level_clipped_px = float(np.minimum(errors_px, _CLIP * error_before_px).mean())
        if level_clipped_px < (1.0 - min_gain) * clipped_px:
            best, clipped_px, error_px = free, level_clipped_px, _median(errors_px)
    return best, error_px


def _free(num_cameras: int, level: Sequence[slice]) -> Free:
    free = none_free(num_cameras)
    for parameters in level:
        free[:, parameters] = True
    return free


def _determined(given: Sequence[Camera], start: Sequence[Camera], sightings: JointSightings, free: Free) -> Free:
    """Parameters of each camera that the sightings determine, in groups: all three of a rotation, or none."""
    sigma = adjust_to_sightings(given, start, sightings, free).sigma * _repetition(sightings)
    determined = free.copy()
    for parameters, largest in _MAX_SIGMA:
        determined[:, parameters] &= (sigma[:, parameters].max(-1) <= largest)[:, None]
    # A position without a rotation would explain the error of the rotation.
    determined[:, POSITION] &= determined[:, ROTATION]
    return determined


def _repetition(sightings: JointSightings) -> float:
    """Factor of standard deviations for instants that are closer than errors of a detector last."""
    num_instants = len(np.unique(sightings.time_s))
    return float(np.sqrt(num_instants / len(np.unique(np.floor(sightings.time_s / _ERROR_LASTS_S)))))


def _cross_validated_px(
    given: Sequence[Camera], start: Sequence[Camera], sightings: JointSightings, free: Free
) -> Float[np.ndarray, " views"]:
    """Reprojection errors of each half of the take with cameras that were fitted to the other half."""
    begin_s, end_s = sightings.time_s.min(), sightings.time_s.max()
    block_s = min(_BLOCK_S, max((end_s - begin_s) / _MIN_BLOCKS, 1e-3))
    is_odd = np.floor((sightings.time_s - begin_s) / block_s) % 2 == 1
    errors_px = []
    for half in (is_odd, ~is_odd):
        fitted = adjust_to_sightings(given, start, sightings.subset(half), free).cameras
        errors_px.append(_errors_px(fitted, sightings.subset(~half)))
    return np.concatenate(errors_px)


def _errors_px(cameras: Sequence[Camera], sightings: JointSightings) -> Float[np.ndarray, " views"]:
    """Distance of each view from the projection of its triangulated point; infinite where there is no projection."""
    xyz_m = sightings.triangulated(cameras)
    projected_px = np.stack([project(camera, xyz_m) for camera in cameras], axis=1)
    error_px = np.linalg.norm(projected_px - sightings.points_px, axis=-1)
    error_px[np.isnan(error_px)] = np.inf
    return error_px[np.isfinite(sightings.points_px).all(-1)]


def _median(errors_px: Float[np.ndarray, " views"]) -> float:
    return float(np.median(errors_px)) if len(errors_px) else np.nan
