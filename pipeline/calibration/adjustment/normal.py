"""Normal equations of an adjustment, with the blocks of the structure eliminated.

Schur complement: Triggs et al. 2000, "Bundle adjustment - a modern synthesis", section 6.1.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import block_diag, bsr_array, csc_array, csr_array, diags_array
from scipy.sparse.linalg import splu

from pipeline.calibration.adjustment.deviations import Deviations, Posterior, posterior
from pipeline.calibration.adjustment.parameters import EXTRINSICS, linearise, offsets
from pipeline.calibration.adjustment.problem import AdjustmentProblem, FreePoints, LinkRows, Structure
from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import project

# Added to the diagonal of a block, relative to its trace: a block that is hardly seen stays where it is.
_RIDGE = 1e-10
# Standard deviation of a camera's delay before anything is observed.
_DELAY_S = 1.0

Solver = Callable[[Float[np.ndarray, "unknowns columns"]], Float[np.ndarray, "unknowns columns"]]


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Unknowns of an adjustment: cameras, structure, lengths of links."""

    cameras: tuple[Camera, ...]
    structure: Structure
    lengths_m: Float[np.ndarray, " lengths"]
    deviations: Deviations | None = None  # ``None``: bodies have one pose for all cameras

    def seen_by(self, camera: int) -> Structure:
        """Structure as a camera sees it."""
        if self.deviations is None:
            return self.structure
        # A copy: SciPy's rotations take no read-only arrays.
        return self.structure.moved(self.deviations.total[camera].copy())


@dataclass(frozen=True, slots=True, eq=False)
class _OfDeviations:
    """Equations of a camera's deviations, solved for them: ``step = -(by_camera x + by_body y + constant)``."""

    own: slice  # The camera's free parameters x among all cameras' parameters; y is the step of the body
    by_camera: Float[np.ndarray, "bodies 6 parameters"]
    by_body: Float[np.ndarray, "bodies 6 6"]
    constant: Float[np.ndarray, "bodies 6"]
    information: Float[np.ndarray, "bodies 6 6"]  # Normal matrices of the views, without what is known of deviations


@dataclass(frozen=True, slots=True, eq=False)
class Normal:
    """Normal equations of the cameras' free parameters and of what is eliminated: the blocks, then the lengths.

    With deviations, the delay of each camera that may move is one more parameter, the last one of the camera.
    """

    # Normal matrix and right side of the free parameters
    cameras: Float[np.ndarray, "parameters parameters"]
    cameras_right: Float[np.ndarray, " parameters"]
    # Mixed part, eliminated unknowns by free parameters; the rows of lengths are zero
    mixed: Float[np.ndarray, "unknowns parameters"]
    blocks: Float[np.ndarray, "blocks size size"]  # Diagonal blocks of the structure, without the links
    right: Float[np.ndarray, " unknowns"]  # Right side of the eliminated unknowns
    # Part of links and priors of lengths in the normal matrix of the eliminated unknowns; ``None`` without links. It is
    # sparse: a length meets the points of its own links alone.
    coupling: csc_array | None
    # Deviations are eliminated before everything else: equations for each camera, none without deviations
    of_deviations: tuple[_OfDeviations, ...] = ()

    def deviation_steps(
        self, step: Float[np.ndarray, " parameters"], of_blocks: Float[np.ndarray, "blocks size"]
    ) -> Float[np.ndarray, "cameras blocks size"]:
        """Step of the deviations that belongs to a step of the free parameters and of the blocks."""
        return -np.array(
            [
                part.by_camera @ step[part.own] + (part.by_body @ of_blocks[:, :, None])[:, :, 0] + part.constant
                for part in self.of_deviations
            ]
        )

    def posterior(self, deviations: Deviations) -> Posterior:
        """Posterior of the deviations, with which the equations were built, for given cameras."""
        return posterior(deviations, np.array([part.information for part in self.of_deviations]), self.blocks)

    def reduced(self) -> Float[np.ndarray, "parameters parameters"]:
        """Normal matrix of the free parameters after the elimination: the inverse of their covariance."""
        return self.cameras - self.mixed.T @ self.eliminated()

    def eliminated(self) -> Float[np.ndarray, "unknowns parameters"]:
        """Negative steps of the eliminated unknowns that belong to unit steps of the free parameters."""
        return self._solver(0.0)(self.mixed)

    def block_covariance(self, chosen: Int[np.ndarray, " chosen"]) -> Float[np.ndarray, "unknowns unknowns"]:
        """Covariance of the parameters of some blocks, with what the cameras leave open.

        Inverse of a matrix in four parts: Triggs et al. 2000, appendix B.
        """
        size = self.blocks.shape[1]
        rows = (size * np.asarray(chosen)[:, None] + np.arange(size)).ravel()
        columns = np.zeros((len(self.mixed), len(rows)))
        columns[rows, np.arange(len(rows))] = 1.0
        solve = self._solver(0.0)
        eliminated = solve(self.mixed)
        reduced = self.cameras - self.mixed.T @ eliminated
        scale = 1.0 / np.sqrt(np.maximum(np.diag(reduced), np.finfo(float).tiny))
        of_cameras = scale[:, None] * np.linalg.pinv(scale[:, None] * reduced * scale, hermitian=True) * scale
        covariance: np.ndarray = solve(columns)[rows] + eliminated[rows] @ of_cameras @ eliminated[rows].T
        return covariance

    def step(self, damping: float) -> tuple[Float[np.ndarray, " parameters"], Float[np.ndarray, " unknowns"]]:
        """Damped step of the free parameters, and of the eliminated unknowns.

        Raises ``LinAlgError`` if the equations are singular.
        """
        eliminated = self._solver(damping)(np.column_stack([self.mixed, self.right]))
        diagonal = np.diag(self.cameras)
        reduced = self.cameras + damping * np.diag(diagonal) - self.mixed.T @ eliminated[:, :-1]
        # Scaled by the diagonal: units of the parameters differ by powers of ten.
        scale = 1.0 / np.sqrt(np.maximum(diagonal, np.finfo(float).tiny))
        right = self.cameras_right - self.mixed.T @ eliminated[:, -1]
        step = -scale * np.linalg.solve(scale[:, None] * reduced * scale, scale * right)
        return step, -(eliminated[:, -1] + eliminated[:, :-1] @ step)

    def _solver(self, damping: float) -> Solver:
        num_blocks, size, _ = self.blocks.shape
        along = np.arange(size)
        blocks = self.blocks.copy()
        if self.coupling is not None:
            of_links = self.coupling.diagonal()
            blocks[:, along, along] += damping * of_links[: num_blocks * size].reshape(-1, size)
        blocks[:, along, along] += damping * self.blocks[:, along, along]
        trace = np.trace(blocks, axis1=1, axis2=2)
        blocks[:, along, along] += _RIDGE * np.maximum(trace, np.median(trace) if len(trace) else 0.0)[:, None]
        if self.coupling is None:
            inverse = np.linalg.inv(blocks)
            return lambda right: (inverse @ right.reshape(num_blocks, size, right.shape[1])).reshape(right.shape)
        numbers = np.arange(num_blocks + 1)
        of_lengths = diags_array(damping * of_links[num_blocks * size :])
        diagonal = block_diag([bsr_array((blocks, numbers[:-1], numbers)), of_lengths])
        matrix = csc_array(diagonal + self.coupling)
        # The matrix is positive definite: pivots of the diagonal are safe, and others would fill it. Its columns are so
        # sparse that panels of several are slower than single ones (38 and 15 ms for 500 bodies).
        options = {"SymmetricMode": True}
        factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, panel_size=1, options=options)
        return lambda right: np.asarray(factors.solve(np.ascontiguousarray(right)))


def build(problem: AdjustmentProblem, state: State, sigma_px: float) -> Normal:
    """Build the normal equations of a state for the noise of the observations; weights come from the loss."""
    has_delay = _has_delay(problem, state)
    starts = np.concatenate([[0], np.cumsum(problem.free.sum(1) + has_delay)])
    num_blocks, size = state.structure.num_blocks, state.structure.block_size
    cameras, cameras_right = np.zeros((starts[-1], starts[-1])), np.zeros(starts[-1])
    mixed = np.zeros((num_blocks, size, starts[-1]))
    blocks, blocks_right = np.zeros((num_blocks, size, size)), np.zeros((num_blocks, size))
    of_deviations: list[_OfDeviations] = []
    for number in range(len(state.cameras)):
        own = slice(starts[number], starts[number + 1])
        rows = np.flatnonzero(problem.observations.camera == number)
        xyz_m, by_block = state.seen_by(number).in_world(
            problem.observations.block[rows], problem.observations.model_m[rows]
        )
        A, B, residual = _weighted_rows(problem, state, number, xyz_m, by_block, sigma_px)
        if state.deviations is not None and has_delay[number]:
            by_delay = B @ state.deviations.speed[problem.observations.block[rows], :, None]
            A = np.concatenate([A, by_delay], axis=2)
        flat = A.reshape(2 * len(rows), A.shape[-1])
        cameras[own, own] = flat.T @ flat
        cameras_right[own] = flat.T @ residual.ravel()
        products = np.concatenate([B.swapaxes(1, 2) @ part for part in (A, B, residual[:, :, None])], axis=2)
        by_blocks = csr_array(
            (np.ones(len(rows)), (problem.observations.block[rows], np.arange(len(rows)))), (num_blocks, len(rows))
        )
        width = products.shape[-1]
        sums = (by_blocks @ products.reshape(len(rows), size * width)).reshape(num_blocks, size, width)
        if state.deviations is not None:
            part = _of_deviations(sums, own, state.deviations, number)
            of_deviations.append(part)
            of_camera = sums[:, :, : A.shape[-1]].swapaxes(1, 2)
            cameras[own, own] -= (of_camera @ part.by_camera).sum(0)
            cameras_right[own] -= (of_camera @ part.constant[:, :, None]).sum(0)[:, 0]
            solved = np.concatenate([part.by_camera, part.by_body, part.constant[:, :, None]], axis=2)
            sums = sums - part.information @ solved
        mixed[:, :, own] = sums[:, :, : A.shape[-1]]
        blocks += sums[:, :, A.shape[-1] : -1]
        blocks_right += sums[:, :, -1]
    is_camera = ~is_delay(problem, state)
    precision, offset = np.full(starts[-1], _DELAY_S**-2.0), np.zeros(starts[-1])
    precision[is_camera] = problem.prior_sigma[problem.free] ** -2.0
    offset[is_camera] = offsets(problem.cameras, state.cameras)[problem.free]
    if state.deviations is not None:
        offset[~is_camera] = state.deviations.delay_s[has_delay]
    cameras[np.diag_indices(starts[-1])] += precision
    cameras_right += precision * offset
    num_lengths = len(state.lengths_m)
    length_precision = problem.length_sigma_m**-2.0
    right = np.concatenate([blocks_right.ravel(), length_precision * (state.lengths_m - problem.lengths_m)])
    flat_mixed = np.concatenate([mixed.reshape(num_blocks * size, starts[-1]), np.zeros((num_lengths, starts[-1]))])
    if not problem.links:
        return Normal(cameras, cameras_right, flat_mixed, blocks, right, None, tuple(of_deviations))
    coupling = csc_array(diags_array(np.concatenate([np.zeros(num_blocks * size), length_precision])))
    for link in problem.links:
        jacobian, residual = _jacobian(
            link.linearise(_xyz_m(state.structure), state.lengths_m), num_blocks, num_lengths
        )
        coupling += csc_array(jacobian.T @ jacobian)
        right += jacobian.T @ residual
    return Normal(cameras, cameras_right, flat_mixed, blocks, right, coupling, tuple(of_deviations))


def _has_delay(problem: AdjustmentProblem, state: State) -> Bool[np.ndarray, " cameras"]:
    """Cameras that have a delay: one that stays has none, since delays of all cameras would only move the bodies."""
    has_deviations = state.deviations is not None
    return np.asarray(problem.free[:, EXTRINSICS].any(1) & has_deviations)


def is_delay(problem: AdjustmentProblem, state: State) -> Bool[np.ndarray, " parameters"]:
    """Mask of the parameters of the normal equations that are delays."""
    parts = [
        np.arange(number + delays) >= number
        for number, delays in zip(problem.free.sum(1), _has_delay(problem, state), strict=True)
    ]
    return np.concatenate(parts)


def _of_deviations(
    sums: Float[np.ndarray, "bodies 6 width"], own: slice, deviations: Deviations, number: int
) -> _OfDeviations:
    """Solve for a camera's deviations.

    ``sums`` are, of each body, products of derivatives by its pose with those by the camera's free parameters, with
    those by the pose, and with the residuals. A deviation changes a view as a step of the pose does.
    """
    precision = deviations.sigma[number] ** -2.0
    information, right = sums[:, :, -7:-1], sums[:, :, -1] + precision * deviations.step[number]
    inverse = np.linalg.inv(information + precision[:, :, None] * np.eye(6))
    constant = (inverse @ right[:, :, None])[:, :, 0]
    return _OfDeviations(own, inverse @ sums[:, :, :-7], inverse @ information, constant, information)


def _weighted_rows(
    problem: AdjustmentProblem,
    state: State,
    number: int,
    xyz_m: Float[np.ndarray, "n 3"],
    by_block: Float[np.ndarray, "n 3 size"],
    sigma_px: float,
) -> tuple[Float[np.ndarray, "n 2 parameters"], Float[np.ndarray, "n 2 size"], Float[np.ndarray, "n 2"]]:
    """Rows of a camera's observations, times the roots of their weights.

    They are derivatives by the camera's free parameters, derivatives by the block, and residuals.
    """
    points_px, by_camera, by_point = linearise(state.cameras[number], xyz_m)
    residual = (points_px - problem.observations.points_px[problem.observations.camera == number]) / sigma_px
    root = np.sqrt(problem.loss.weights(np.linalg.norm(residual, axis=-1)))
    factor = (root / sigma_px)[:, None, None]
    return factor * by_camera[:, :, problem.free[number]], factor * (by_point @ by_block), root[:, None] * residual


class ObservationRows(NamedTuple):
    """Residuals of observations, and what they ask of the cameras."""

    residual: Float[np.ndarray, "n 2"]  # In units of the noise
    weight: Float[np.ndarray, " n"]  # Weights of the loss
    # Derivatives of the right side of the reduced normal equations by the residuals
    scores: Float[np.ndarray, "n 2 parameters"]


def observation_rows(
    problem: AdjustmentProblem,
    state: State,
    sigma_px: float,
    eliminated: Float[np.ndarray, "unknowns parameters"],
) -> ObservationRows:
    """Rows of all observations for a state without deviations.

    ``eliminated`` belongs to the normal equations of the state.
    """
    starts = np.concatenate([[0], np.cumsum(problem.free.sum(1))])
    num_blocks, size = state.structure.num_blocks, state.structure.block_size
    of_blocks = eliminated[: num_blocks * size].reshape(num_blocks, size, starts[-1])
    residual = residuals_px(problem, state) / sigma_px
    weight = problem.loss.weights(np.linalg.norm(residual, axis=-1))
    scores = np.zeros((len(residual), 2, starts[-1]))
    for number in range(len(state.cameras)):
        rows = np.flatnonzero(problem.observations.camera == number)
        block = problem.observations.block[rows]
        xyz_m, by_block = state.structure.in_world(block, problem.observations.model_m[rows])
        A, B, _ = _weighted_rows(problem, state, number, xyz_m, by_block, sigma_px)
        root = np.sqrt(weight[rows])[:, None, None]
        scores[rows] = -root * (B @ of_blocks[block])
        scores[rows, :, starts[number] : starts[number + 1]] += root * A
    return ObservationRows(residual, weight, scores)


def cost(problem: AdjustmentProblem, state: State, sigma_px: float) -> float:
    """Loss of the observations, priors and links; infinite if a point is behind a camera that sees it."""
    distance = np.linalg.norm(residuals_px(problem, state), axis=-1) / sigma_px
    total = problem.loss.cost(distance)
    total += float(((offsets(problem.cameras, state.cameras) / problem.prior_sigma) ** 2)[problem.free].sum())
    total += float((((state.lengths_m - problem.lengths_m) / problem.length_sigma_m) ** 2).sum())
    if state.deviations is not None:
        total += float(((state.deviations.step / state.deviations.sigma) ** 2).sum())
        total += float((state.deviations.delay_s**2).sum()) / _DELAY_S**2
    for link in problem.links:
        total += float((link.linearise(_xyz_m(state.structure), state.lengths_m).residual ** 2).sum())
    return total if np.isfinite(total) else np.inf


def residuals_px(problem: AdjustmentProblem, state: State) -> Float[np.ndarray, "n 2"]:
    """Projections minus observations; NaN behind a camera."""
    seen = problem.observations
    residual_px = np.full(seen.points_px.shape, np.nan)
    for number, camera in enumerate(state.cameras):
        rows = seen.camera == number
        xyz_m, _ = state.seen_by(number).in_world(seen.block[rows], seen.model_m[rows])
        residual_px[rows] = project(camera, xyz_m) - seen.points_px[rows]
    return residual_px


def _xyz_m(structure: Structure) -> Float[np.ndarray, "points 3"]:
    """Coordinates of free points; links are between free points only."""
    if not isinstance(structure, FreePoints):
        raise TypeError("Links need free points.")
    return structure.xyz_m


def _jacobian(rows: LinkRows, num_points: int, num_lengths: int) -> tuple[csr_array, Float[np.ndarray, " rows"]]:
    """Sparse derivatives of link rows by the coordinates of the points and by the lengths, and the residuals."""
    number = np.arange(len(rows.residual))
    by_point = 3 * rows.points[:, :, None] + np.arange(3)
    has_length = rows.by_length != 0
    values = np.concatenate([rows.by_points.ravel(), rows.by_length[has_length]])
    row = np.concatenate([np.repeat(number, 6), number[has_length]])
    column = np.concatenate([by_point.ravel(), 3 * num_points + rows.length[has_length]])
    return csr_array((values, (row, column)), (len(number), 3 * num_points + num_lengths)), rows.residual
