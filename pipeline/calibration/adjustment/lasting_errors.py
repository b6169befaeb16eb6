"""Covariance of adjusted cameras from observations whose errors last, such as a detector's joints.

The inverse of the normal matrix holds for independent errors. A detector marks a joint of a person beside its place in
all pictures of a camera, and for some instants by more: the more observations there are, the less of the truth it
tells. Errors are random effects of nested levels (Laird and Ware 1982, "Random-effects models for longitudinal data"):
one of a joint in a camera for the whole take, one for a part of it, and one of each observation. The residuals tell
their variances by moments, and the normal equations their effect on the cameras.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import nnls

from pipeline.calibration.adjustment.bundle import Adjustment
from pipeline.calibration.adjustment.normal import ObservationRows, build, observation_rows
from pipeline.calibration.adjustment.problem import AdjustmentProblem

# Least share of the freedom of means of residuals that the unknowns leave.
_MIN_FREEDOM = 0.1


def lasting_covariance(
    problem: AdjustmentProblem,
    adjusted: Adjustment,
    levels: Sequence[Int[np.ndarray, " n"]],
    biases: Sequence[tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"]]] = (),
) -> tuple[Float[np.ndarray, "parameters parameters"], Float[np.ndarray, "parameters parameters"]]:
    """Compute the reduced normal matrix of the free parameters, and the covariance of its right side.

    With the inverse N of the first and the second S, N S N is the covariance of the parameters (White 1982).

    ``problem``, ``adjusted``: an adjustment of free points without deviations. ``levels``: number of the subject of
    each observation, such as a joint of a person, of nested levels: coarse ones first. A camera's observations of a
    subject have a common error. ``biases``: subjects of more levels, whose errors the cameras absorb, so that residuals
    don't tell them, and the standard deviation of each observation's part in pixels.
    """
    normal = build(problem, adjusted.state, adjusted.sigma_px)
    eliminated = normal.eliminated()
    reduced = normal.cameras - normal.mixed.T @ eliminated
    rows = observation_rows(problem, adjusted.state, adjusted.sigma_px, eliminated)
    count = len(rows.weight)
    clusters = [_numbered(np.column_stack([subject, problem.observations.camera])) for subject in levels]
    clusters.append(np.arange(count))
    variances = _variances(rows, levels, clusters, adjusted.state.structure.num_blocks)
    spread = sum(
        (variance * _common(cluster, rows.scores) for cluster, variance in zip(clusters, variances, strict=True)),
        start=np.zeros_like(reduced),
    )
    for subject, sigma_px in biases:
        cluster = _numbered(np.column_stack([subject, problem.observations.camera]))
        spread += _common(cluster, rows.scores * (sigma_px / adjusted.sigma_px)[:, None, None])
    if normal.coupling is not None:
        spread += eliminated.T @ (normal.coupling @ eliminated)
    return reduced, spread


def _common(
    cluster: Int[np.ndarray, " n"], scores: Float[np.ndarray, "n 2 parameters"]
) -> Float[np.ndarray, "parameters parameters"]:
    """Covariance of the right side by unit errors that the observations of a cluster have in common."""
    sums = np.zeros((int(cluster.max(initial=-1)) + 1, *scores.shape[1:]))
    np.add.at(sums, cluster, scores)
    return np.einsum("cip,ciq->pq", sums, sums)


def _numbered(keys: Int[np.ndarray, "n columns"]) -> Int[np.ndarray, " n"]:
    """Number of each distinct row."""
    return np.unique(keys, axis=0, return_inverse=True)[1].ravel()


def _variances(
    rows: ObservationRows,
    subjects: Sequence[Int[np.ndarray, " n"]],
    clusters: Sequence[Int[np.ndarray, " n"]],
    num_points: int,
) -> Float[np.ndarray, " levels"]:
    """Variances of the errors of each level in units of the noise, the last one of single observations.

    The mean square of the clusters' mean residuals is the variance of the level and of coarser ones, and a share of
    the freedom of finer ones. Points take three freedoms of a subject, the cameras the freedoms of their parameters.
    """
    num_levels, num_free = len(clusters), rows.scores.shape[2]
    moments, shares = np.zeros(num_levels), np.zeros((num_levels, num_levels))
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
