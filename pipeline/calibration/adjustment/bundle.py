"""Bundle adjustment: robust Levenberg-Marquardt with the structure eliminated, and the covariance of the cameras."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from pipeline.calibration.adjustment import parameters
from pipeline.calibration.adjustment.deviations import Deviations, estimated, num_effective
from pipeline.calibration.adjustment.normal import Normal, State, build, cost, is_delay, residuals_px
from pipeline.calibration.adjustment.problem import AdjustmentProblem, Structure
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera

_MIN_SIGMA_PX, _NUM_SCALES, _MAX_STEPS = 0.01, 4, 60
# Searches while the variances of deviations are estimated, and their relative change that ends them.
_NUM_VARIANCES, _SMALL_VARIANCE_CHANGE = 20, 0.02
_MAX_DAMPING, _MIN_DAMPING = 1e10, 1e-12
# Ends of the search: relative decrease of the cost, and relative change of the noise between searches.
_SMALL_DECREASE, _SMALL_CHANGE = 1e-9, 1e-3
# Directions with less information than this share of a parameter's own are undetermined.
_UNDETERMINED = 1e-11


@dataclass(frozen=True, slots=True, eq=False)
class Adjustment:
    """Adjusted cameras and structure."""

    # Unknowns after the adjustment
    cameras: tuple[Camera, ...]
    structure: Structure
    lengths_m: Float[np.ndarray, " lengths"]
    # Standard deviations of the cameras' parameters: 0 where a parameter was not free, infinite where the data don't
    # determine it
    sigma: parameters.Parameters
    # Projections minus observations, of bodies at the pose that all cameras share
    residuals_px: Float[np.ndarray, "n 2"]
    sigma_px: float  # Standard deviation of an observation's coordinate
    own_residuals_px: Float[np.ndarray, "n 2"]  # The same, of bodies at the poses at which each camera sees them
    deviations: Deviations | None = None  # ``None``: bodies have one pose for all cameras

    @property
    def state(self) -> State:
        """Unknowns after the adjustment."""
        return State(self.cameras, self.structure, self.lengths_m, self.deviations)

    def error_px(self, camera: Int[np.ndarray, " n"], is_own: bool = False) -> Float[np.ndarray, " cameras"]:
        """Median distance of each camera's projections from its observations; NaN without any.

        ``camera`` has the number of each observation's camera; ``is_own`` asks for bodies at the poses at which each
        camera sees them, not at those that all cameras share.
        """
        distance_px = np.linalg.norm(self.own_residuals_px if is_own else self.residuals_px, axis=-1)
        medians = [
            np.nanmedian(own) if len(own := distance_px[camera == k]) else np.nan for k in range(len(self.cameras))
        ]
        return read_only(np.array(medians))


def adjust(
    problem: AdjustmentProblem,
    structure: Structure,
    start: tuple[Camera, ...] | None = None,
    sigma_px: float | None = None,
    max_steps: int = _MAX_STEPS,
    small_step: parameters.Parameters | None = None,
    deviations: Deviations | None = None,
) -> Adjustment:
    """Fit cameras and structure to observations.

    Parameters
    ----------
    problem
        Cameras, their free parameters with priors, and observations in distorted pixels.
    structure
        Structure with which the search begins. Every point must be in front of the cameras that see it.
    start
        Cameras with which the search begins; the given ones by default.
    sigma_px
        Standard deviation of an observation's coordinate; by default estimated from the residuals, robustly.
    max_steps
        Limit on the steps of a search.
    small_step
        Steps of the cameras' parameters that end a search: what is left to gain is the structure's.
    deviations
        Deviations of rigid bodies with which the search begins, with variances that are estimated; by default bodies
        have one pose for all cameras.

    Returns
    -------
    Adjustment
        Cameras and structure in metres, standard deviations of the cameras' parameters (infinite where the data do not
        determine them), and residuals in pixels.

    References
    ----------
    Triggs et al., "Bundle adjustment: a modern synthesis" (2000).

    Examples
    --------
    >>> from pipeline.calibration.adjustment.problem import FreePoints, observations_of_points
    >>> from pipeline.geometry.camera import project
    >>> from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras
    >>> rng = np.random.default_rng(0)
    >>> cameras = build_cameras(Rig(Layout.RING, 3, (3.0, 2.5), 2.0), rng)
    >>> points_m = rng.uniform(-1.0, 1.0, (30, 3)) + np.array([0.0, 0.0, 1.0])
    >>> seen = observations_of_points(np.stack([project(camera, points_m) for camera in cameras], axis=1))
    >>> free = parameters.none_free(3)
    >>> free[1:, parameters.ROTATION] = True
    >>> turned = [cameras[0], *(parameters.move_camera(camera, 0.01 * free[1]) for camera in cameras[1:])]
    >>> problem = AdjustmentProblem(tuple(turned), free, parameters.no_prior(3), seen)
    >>> found = adjust(problem, FreePoints(points_m))
    >>> bool(np.abs(found.residuals_px).max() < 1e-3)
    True
    """
    state = State(start or problem.cameras, structure, problem.lengths_m, deviations)
    noise_px = sigma_px or _noise_px(problem, state)
    for _ in range(_NUM_SCALES if deviations is None else _NUM_VARIANCES):
        state = _search(problem, state, noise_px, max_steps, small_step)
        state, num_deviations, is_settled = _with_variances(problem, state, noise_px)
        estimated_px = sigma_px or _noise_px(problem, state, num_deviations)
        is_settled &= abs(np.log(estimated_px / noise_px)) < _SMALL_CHANGE
        noise_px = estimated_px
        if is_settled:
            break
    state = _at_middle_time(state)
    sigma = camera_sigma(problem, state, noise_px)
    of_shared = read_only(residuals_px(problem, replace(state, deviations=None)))
    return Adjustment(
        state.cameras,
        state.structure,
        state.lengths_m,
        sigma,
        of_shared,
        noise_px,
        of_shared if deviations is None else read_only(residuals_px(problem, state)),
        state.deviations,
    )


def _at_middle_time(state: State) -> State:
    """Equal state with bodies where the median camera sees them, whose delay then is 0."""
    if state.deviations is None:
        return state
    middle_s = np.median(state.deviations.delay_s)
    deviations = replace(state.deviations, delay_s=read_only(state.deviations.delay_s - middle_s))
    return replace(state, structure=state.structure.moved(middle_s * state.deviations.speed), deviations=deviations)


def _with_variances(problem: AdjustmentProblem, state: State, sigma_px: float) -> tuple[State, float, bool]:
    """State with new variances of the deviations, their effective number, and whether the variances hardly changed."""
    if state.deviations is None:
        return state, 0.0, True
    found = build(problem, state, sigma_px).posterior(state.deviations)
    deviations = estimated(state.deviations, found)
    change = np.abs(np.log(deviations.scale / state.deviations.scale)).max()
    number = num_effective(state.deviations, found)
    return replace(state, deviations=deviations), number, bool(change < _SMALL_VARIANCE_CHANGE)


def camera_sigma(problem: AdjustmentProblem, state: State, sigma_px: float) -> parameters.Parameters:
    """Compute standard deviations of the cameras' parameters from the inverse of the reduced normal matrix."""
    sigma = np.zeros((len(state.cameras), parameters.NUM_PARAMETERS))
    reduced = build(problem, state, sigma_px).reduced()
    diagonal = np.diag(reduced)
    scale = 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(scale[:, None] * reduced * scale)
    is_known = values > _UNDETERMINED * max(1.0, values.max(initial=0.0))
    variance = (vectors[:, is_known] ** 2 / values[is_known]).sum(1) * scale**2
    is_open = (vectors[:, ~is_known] ** 2).sum(1) > np.sqrt(_UNDETERMINED)
    of_parameters = np.where(is_open, np.inf, np.sqrt(variance))
    sigma[problem.free] = of_parameters[~is_delay(problem, state)]
    return read_only(sigma)


def block_covariance(
    problem: AdjustmentProblem, adjusted: Adjustment, blocks: Int[np.ndarray, " blocks"]
) -> Float[np.ndarray, "unknowns unknowns"]:
    """Compute the covariance of the parameters of some blocks of an adjusted structure, one block after the other."""
    return build(problem, adjusted.state, adjusted.sigma_px).block_covariance(blocks)


def _noise_px(problem: AdjustmentProblem, state: State, num_deviations: float = 0.0) -> float:
    """Estimate the noise of a coordinate from the median distance (Rayleigh), for the freedom of the unknowns."""
    distance_px = np.linalg.norm(residuals_px(problem, state), axis=-1)
    distance_px = distance_px[np.isfinite(distance_px)]
    if not len(distance_px):
        return _MIN_SIGMA_PX
    num_unknowns = problem.free.sum() + state.structure.num_blocks * state.structure.block_size + num_deviations
    left = max(0.1, 1.0 - float(num_unknowns) / (2 * len(distance_px)))
    return max(_MIN_SIGMA_PX, float(np.median(distance_px)) / np.sqrt(2 * np.log(2)) / np.sqrt(left))


def _search(
    problem: AdjustmentProblem, state: State, sigma_px: float, max_steps: int, small_step: parameters.Parameters | None
) -> State:
    """Run Levenberg-Marquardt from a state with a fixed noise."""
    damping, lowest = 1e-4, cost(problem, state, sigma_px)
    for _ in range(max_steps):
        normal = build(problem, state, sigma_px)
        before = lowest
        while damping < _MAX_DAMPING:
            step, eliminated = normal.step(damping)
            changed = _moved(problem, state, normal, step, eliminated)
            if (changed_cost := cost(problem, changed, sigma_px)) < lowest:
                state, lowest = changed, changed_cost
                break
            damping *= 10.0
        damping = max(_MIN_DAMPING, damping / 10.0)
        is_small = small_step is not None and (np.abs(step) <= small_step[problem.free]).all()
        if is_small or before - lowest <= _SMALL_DECREASE * before:
            break
    return state


def _moved(
    problem: AdjustmentProblem,
    state: State,
    normal: Normal,
    step: Float[np.ndarray, " parameters"],
    eliminated: Float[np.ndarray, " unknowns"],
) -> State:
    """State after a step of the cameras' free parameters, of the structure's blocks, and of all else."""
    of_cameras, of_delays = np.zeros(problem.free.shape), is_delay(problem, state)
    of_cameras[problem.free] = step[~of_delays]
    cameras = tuple(
        parameters.move_camera(camera, step) for camera, step in zip(state.cameras, of_cameras, strict=True)
    )
    num_blocks, size = state.structure.num_blocks, state.structure.block_size
    of_blocks = eliminated[: num_blocks * size].reshape(num_blocks, size)
    lengths_m = read_only(state.lengths_m + eliminated[num_blocks * size :])
    deviations = state.deviations
    if deviations is not None:
        moved = deviations.step + normal.deviation_steps(step, of_blocks)
        delay_s = deviations.delay_s.copy()
        delay_s[problem.free[:, parameters.EXTRINSICS].any(1)] += step[of_delays]
        deviations = replace(deviations, step=read_only(moved), delay_s=read_only(delay_s))
    return State(cameras, state.structure.moved(of_blocks), lengths_m, deviations)
