"""Standard deviations of adjusted cameras from observations whose errors last, such as a detector's joints.

The inverse of the normal matrix holds for independent errors. A detector marks a joint of a person beside its place in
all pictures of a camera, and for some instants by more: the more observations there are, the less of the truth it
tells. Errors are random effects of nested levels (Laird and Ware 1982, "Random-effects models for longitudinal data"):
one of a joint in a camera for the whole take, one for a part of it, and one of each observation. The residuals tell
their variances by moments, and the normal equations what they do to the cameras.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import nnls

from pipeline.calibration.adjustment import parameters
from pipeline.calibration.adjustment.bundle import Adjustment
from pipeline.calibration.adjustment.normal import ObservationRows, build, observation_rows
from pipeline.calibration.adjustment.problem import AdjustmentProblem
from pipeline.core.data.arrays import read_only

# Metric in which cameras hold the world: a turn and a shift that count as much.
_TURN_RAD, _SHIFT_M = np.radians(0.3), 0.02
# Least share of the freedom of means of residuals that the unknowns leave.
_MIN_FREEDOM = 0.1


def correlated_sigma(
    problem: AdjustmentProblem, adjusted: Adjustment, levels: Sequence[Int[np.ndarray, " n"]]
) -> parameters.Parameters:
    """Compute standard deviations of the cameras' parameters, each camera's in the world that the others hold.

    ``problem``, ``adjusted``: an adjustment of free points without deviations, of which some extrinsics hold the world.
    ``levels``: number of the subject of each observation, such as a joint of a person, of nested levels: coarse ones
    first. A camera's observations of a subject have a common error. Returns standard deviations: 0 where a parameter
    other than extrinsics was not free. Extrinsics have the covariance of the errors that are left after the similarity
    that fits the other cameras best.
    """
    normal = build(problem, adjusted.state, adjusted.sigma_px)
    eliminated = normal.eliminated()
    reduced = normal.cameras - normal.mixed.T @ eliminated
    rows = observation_rows(problem, adjusted.state, adjusted.sigma_px, eliminated)
    count = len(rows.weight)
    subjects = [*levels, np.arange(count)]
    clusters = [_numbered(np.column_stack([subject, problem.observations.camera])) for subject in levels]
    clusters.append(np.arange(count))
    variances = _variances(rows, subjects[:-1], clusters, problem, adjusted)
    spread = np.zeros_like(reduced)
    for cluster, variance in zip(clusters, variances, strict=True):
        sums = np.zeros((int(cluster.max(initial=-1)) + 1, *rows.scores.shape[1:]))
        np.add.at(sums, cluster, rows.scores)
        spread += variance * np.einsum("cip,ciq->pq", sums, sums)
    if normal.coupling is not None:
        spread += eliminated.T @ (normal.coupling @ eliminated)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(reduced), np.finfo(float).tiny))
    inverse = scale[:, None] * np.linalg.pinv(scale[:, None] * reduced * scale, hermitian=True) * scale
    return _beside_others(problem, adjusted, inverse @ spread @ inverse)


def _numbered(keys: Int[np.ndarray, "n columns"]) -> Int[np.ndarray, " n"]:
    """Number of each distinct row."""
    return np.unique(keys, axis=0, return_inverse=True)[1].ravel()


def _variances(
    rows: ObservationRows,
    subjects: Sequence[Int[np.ndarray, " n"]],
    clusters: Sequence[Int[np.ndarray, " n"]],
    problem: AdjustmentProblem,
    adjusted: Adjustment,
) -> Float[np.ndarray, " levels"]:
    """Variances of the errors of each level in units of the noise, the last one of single observations.

    The mean square of the clusters' mean residuals is the variance of the level and of coarser ones, and a share of
    the freedom of finer ones. Points take three freedoms of a subject, the cameras the freedoms of their parameters.
    """
    num_levels, num_free = len(clusters), rows.scores.shape[2]
    moments, shares = np.zeros(num_levels), np.zeros((num_levels, num_levels))
    num_points = adjusted.state.structure.num_blocks
    for level, cluster in enumerate(clusters):
        total = np.bincount(cluster, rows.weight)
        means = (
            np.stack([np.bincount(cluster, rows.weight * along) for along in rows.residual.T], axis=1) / total[:, None]
        )
        num_taken = len(np.unique(subjects[level])) if level < len(subjects) else num_points
        freedom = max(_MIN_FREEDOM, 1.0 - (3.0 * num_taken + num_free) / (2.0 * len(total)))
        weight = np.minimum(total, np.median(total))
        moments[level] = float((weight * (means**2).sum(1)).sum() / weight.sum() / 2 / freedom)
        for other, finer in enumerate(clusters):
            within = np.bincount(finer, rows.weight)
            owner = np.zeros(len(within), int)
            owner[finer] = cluster
            parts = np.bincount(owner, within**2, len(total)) / total**2 if other > level else np.ones(len(total))
            shares[level, other] = float((weight * parts).sum() / weight.sum())
    return nnls(shares, moments)[0]


def _beside_others(
    problem: AdjustmentProblem, adjusted: Adjustment, covariance: Float[np.ndarray, "parameters parameters"]
) -> parameters.Parameters:
    """Standard deviations of each camera after the move of the world that changes the other cameras least.

    Of two cameras both hold the world: one alone does not tell its scale.
    """
    free = problem.free
    num_cameras = len(free)
    whole = np.zeros((free.size, free.size))
    rows = np.flatnonzero(free)
    whole[np.ix_(rows, rows)] = covariance
    moves = parameters.world_moves(adjusted.cameras)
    metric = np.zeros(parameters.NUM_PARAMETERS)
    metric[parameters.ROTATION], metric[parameters.POSITION] = _TURN_RAD**-2.0, _SHIFT_M**-2.0
    sigma = np.zeros(free.shape)
    for number in range(num_cameras):
        holds = np.ones(num_cameras)
        if num_cameras > 2:
            holds[number] = 0.0
        weighted = (moves * metric[:, None] * holds[:, None, None]).reshape(free.size, -1)
        back = moves[number] @ np.linalg.solve(weighted.T @ moves.reshape(free.size, -1), weighted.T)
        change = -back
        change[:, number * parameters.NUM_PARAMETERS : (number + 1) * parameters.NUM_PARAMETERS] += np.eye(
            parameters.NUM_PARAMETERS
        )
        sigma[number] = np.sqrt(np.maximum(np.einsum("pi,ij,pj->p", change, whole, change), 0.0))
    sigma[:, parameters.EXTRINSICS.stop :][~free[:, parameters.EXTRINSICS.stop :]] = 0.0
    return read_only(sigma)
