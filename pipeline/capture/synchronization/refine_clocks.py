"""Fine offsets and rates of all cameras at once: Gauss-Newton on the epipolar errors of people's joints.

A joint is sampled at any instant of a camera's own time, so the error is a smooth function of the clocks. Cameras are
calibrated, and detectors mark joints, with errors that last: a constant error of a joint would be taken for an offset
while the joint moves steadily. So each joint of each person and pair of cameras has a constant of its own, and the
clocks follow from what changes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from pipeline.capture.synchronization.motions import STEP_S, BodyMotion
from pipeline.capture.synchronization.pair_curves import essential_matrix
from pipeline.core.data.cameras import Camera

Match = tuple[int, int]
"""Numbers of two motions that are one person."""

_CONVERGED_S = 2e-5
# Time for which errors of a detector last, and length of the blocks of time that count as independent.
_ERROR_LASTS_S, _BLOCK_S = 0.8, 1.0
# Standard deviation of the constant error of a joint, in tolerances.
_CONSTANT_SIGMA = 2.0
# Errors beyond so many standard deviations lose weight. Joints that a detector marks wrongly while they move would be
# taken for offsets: chosen on three rendered clips. Clocks that are far off need more in the first steps: by 0.7 alone
# three steps reach 8 of 32 ms.
_ROBUST, _FIRST_ROBUST, _NUM_FIRST = 0.7, 2.0, 3
# Standard deviation of rates before anything is measured: clocks of cameras differ by some 10 to 100 ppm.
_RATE_SIGMA = 3e-4


@dataclass(frozen=True, slots=True, eq=False)
class FineClocks:
    """Clocks of all cameras: ``session time = offset_s + own + drift * (own - pivot_s)``."""

    # Of each camera; the reference's are 0
    offset_s: Float[np.ndarray, " cameras"]
    drift: Float[np.ndarray, " cameras"]
    pivot_s: float  # Own time at which an offset holds
    # Of the offsets, then the drifts, of all cameras; zeros for the reference. It rests on how much blocks of time
    # disagree, so it includes errors that the cameras share.
    covariance: Float[np.ndarray, "parameters parameters"]
    error: float  # Standard deviation of the errors, in tolerances, without the constants
    num_blocks: int  # Blocks of time


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """Linearised errors of joints."""

    residual: Float[np.ndarray, " rows"]
    cameras: Int[np.ndarray, "rows 2"]
    by_time: Float[np.ndarray, "rows 2"]
    own_s: Float[np.ndarray, "rows 2"]
    group: Int[np.ndarray, " rows"]
    block: Int[np.ndarray, " rows"]


def refine_clocks(
    cameras: Sequence[Camera],
    motions: Sequence[BodyMotion],
    matches: Sequence[Match],
    offset_s: Float[np.ndarray, " cameras"],
    has_drift: bool,
    reference: int = 0,
    max_instants: int = 20_000,
    max_steps: int = 15,
) -> FineClocks:
    """Refine clocks.

    ``matches`` are motions of two cameras that are one person. Offsets start from ``offset_s``; without ``has_drift``
    rates are 1. The session's clock is the clock of camera ``reference``. Instants are of all matches together.
    """
    offset_s, drift = offset_s.astype(float), np.zeros(len(cameras))
    begin, end = (
        min((motion.first for motion in motions), default=0),
        max((motion.stop for motion in motions), default=0),
    )
    pivot_s = STEP_S * (begin + end) / 2
    essentials = {
        (a, b): essential_matrix(cameras[a], cameras[b])
        for a, b in {(motions[first].camera, motions[second].camera) for first, second in matches}
    }
    free = np.ones(2 * len(cameras), bool)
    free[[reference, reference + len(cameras)]] = False
    free[len(cameras) :] &= has_drift
    prior = np.concatenate([np.zeros(len(cameras)), np.full(len(cameras), _RATE_SIGMA**-2)])
    step_s = _step_s(motions, matches, max_instants)
    share = min(1.0, step_s / _ERROR_LASTS_S)
    normal, scores = np.zeros((len(prior), len(prior))), np.zeros((0, len(prior)))
    sigma = np.nan
    num_blocks = 0
    for step in range(max_steps):
        rows = _linearise(motions, matches, essentials, (offset_s, drift, pivot_s), step_s)
        if not len(rows.residual):
            break
        robust = _FIRST_ROBUST if step < _NUM_FIRST else _ROBUST
        residual, jacobian, weight, sigma = _without_constants(rows, _jacobian(rows, pivot_s), share, robust)
        # A share of the rows is independent; the rest repeats their errors.
        factor = share / sigma**2
        column = np.concatenate([rows.cameras, rows.cameras + len(cameras)], axis=1)
        by_residual = factor * (weight * residual)[:, None] * jacobian
        scores = _summed(rows.block[:, None], column, by_residual, (rows.block.max() + 1, len(prior)))
        by_row = factor * weight[:, None, None] * jacobian[:, :, None] * jacobian[:, None]
        normal = _summed(column[:, :, None], column[:, None], by_row, normal.shape)
        values = np.concatenate([offset_s, drift])
        gradient = scores.sum(0) + prior * values
        damped = normal + np.diag(prior) + 1e-9 * np.eye(len(normal)) * max(float(np.trace(normal)), 1e-9)
        change = np.zeros(len(values))
        change[free] = -np.linalg.solve(damped[np.ix_(free, free)], gradient[free])
        change[: len(cameras)] = np.clip(change[: len(cameras)], -0.05, 0.05)
        offset_s, drift = offset_s + change[: len(cameras)], drift + change[len(cameras) :]
        num_blocks = len(np.unique(rows.block))
        if step >= _NUM_FIRST and np.abs(change[: len(cameras)]).max() < _CONVERGED_S:
            break
    covariance = _covariance(normal, scores, prior, free, num_blocks)
    return FineClocks(offset_s, drift, pivot_s, covariance, float(sigma), num_blocks)


def _step_s(motions: Sequence[BodyMotion], matches: Sequence[Match], max_instants: int) -> float:
    """Time between two sampled instants."""
    points = sum(min(len(motions[a].points), len(motions[b].points)) for a, b in matches)
    return STEP_S * max(2.0, points / max_instants)


def own_times_s(
    time_s: Float[np.ndarray, " n"], offset_s: float, drift: float, pivot_s: float
) -> Float[np.ndarray, " n"]:
    """Own times of a camera at session times."""
    return (time_s - offset_s + drift * pivot_s) / (1.0 + drift)


def _linearise(
    motions: Sequence[BodyMotion],
    matches: Sequence[Match],
    essentials: dict[tuple[int, int], Float[np.ndarray, "3 3"]],
    clocks: tuple[Float[np.ndarray, " cameras"], Float[np.ndarray, " cameras"], float],
    step_s: float,
) -> _Rows:
    """Signed Sampson errors of all joints of all matches, in tolerances, and their derivatives by own times."""
    offset_s, drift, pivot_s = clocks
    sampled = [_sampled(motion, offset_s[motion.camera], drift[motion.camera], pivot_s, step_s) for motion in motions]
    parts: list[tuple[np.ndarray, ...]] = []
    for number, (a, b) in enumerate(matches):
        first, second = motions[a], motions[b]
        begin = max(sampled[a].first, sampled[b].first)
        stop = min(side.first + len(side.own_s) for side in (sampled[a], sampled[b]))
        if stop <= begin:
            continue
        time_s = step_s * np.arange(begin, stop)
        both = [(side, slice(begin - side.first, stop - side.first)) for side in (sampled[a], sampled[b])]
        (left, right), own_s = [side.points[at] for side, at in both], [side.own_s[at] for side, at in both]
        left_speed, right_speed = (side.speed[at] for side, at in both)
        essential = essentials[first.camera, second.camera]
        line_in_right = left @ essential[:, :2].T + essential[:, 2]
        line_in_left = right @ essential[:2] + essential[2]
        across_right, across_left = line_in_right[..., :2], line_in_left[..., :2]
        norm = np.sqrt(np.vecdot(across_right, across_right) + np.vecdot(across_left, across_left))
        norm *= np.sqrt((first.tolerance**2 + second.tolerance**2) / 2)
        residual = (np.vecdot(right, across_right) + line_in_right[..., 2]) / norm
        by_first, by_second = np.vecdot(across_left, left_speed) / norm, np.vecdot(across_right, right_speed) / norm
        rows, joints = np.nonzero(np.isfinite(residual))
        parts.append(
            (
                residual[rows, joints],
                np.tile([first.camera, second.camera], (len(rows), 1)),
                np.column_stack([by_first[rows, joints], by_second[rows, joints]]),
                np.column_stack([own_s[0][rows], own_s[1][rows]]),
                number * residual.shape[1] + joints,
                np.floor(time_s[rows] / _BLOCK_S).astype(np.int64),
            )
        )
    if not parts:
        none = np.empty(0, int)
        return _Rows(np.empty(0), np.empty((0, 2), int), np.empty((0, 2)), np.empty((0, 2)), none, none)
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    columns[5] -= columns[5].min()
    return _Rows(*columns)


class _Sampled(NamedTuple):
    """Joints and their speeds at the instants ``step_s * (first + k)`` of the session that a motion has."""

    first: int
    own_s: Float[np.ndarray, " n"]
    points: Float[np.ndarray, "n joints 2"]
    speed: Float[np.ndarray, "n joints 2"]


def _sampled(motion: BodyMotion, offset_s: float, drift: float, pivot_s: float, step_s: float) -> _Sampled:
    begin_s, end_s = STEP_S * np.array([motion.first, motion.stop - 1]) * (1 + drift) + offset_s - drift * pivot_s
    first = int(np.ceil(begin_s / step_s))
    own_s = own_times_s(step_s * np.arange(first, np.floor(end_s / step_s) + 1), offset_s, drift, pivot_s)
    place = np.clip(own_s / STEP_S - motion.first, 0, len(motion.points) - 1)
    row = np.minimum(place.astype(np.int64), len(motion.points) - 2)
    share = (place - row)[:, None, None]
    points, speed = ((1 - share) * values[row] + share * values[row + 1] for values in (motion.points, motion.speed))
    return _Sampled(first, own_s, points, speed)


def _jacobian(rows: _Rows, pivot_s: float) -> Float[np.ndarray, "rows 4"]:
    """Derivatives by the offsets, then the drifts, of a row's two cameras: a later clock shows an earlier instant."""
    return np.concatenate([-rows.by_time, -rows.by_time * (rows.own_s - pivot_s)], axis=1)


def _summed(
    first: Int[np.ndarray, "*#places"],
    second: Int[np.ndarray, "*#places"],
    values: Float[np.ndarray, "*places"],
    shape: tuple[int, int],
) -> Float[np.ndarray, "first second"]:
    """Sum values at their places in an array."""
    place = np.broadcast_to(first * shape[1] + second, values.shape)
    return np.bincount(place.ravel(), values.ravel(), shape[0] * shape[1]).reshape(shape)


def _without_constants(
    rows: _Rows, jacobian: Float[np.ndarray, "rows 4"], share: float, robust: float
) -> tuple[
    Float[np.ndarray, " rows"], Float[np.ndarray, "rows 4"], Float[np.ndarray, " rows"], float
]:  # fmt: skip
    """Residuals and derivatives less the constant of each group, weights of the rows, and their deviation."""
    num_groups = int(rows.group.max()) + 1
    weight = np.ones(len(rows.residual))
    sigma = np.nan
    for _ in range(4):
        total = np.bincount(rows.group, weight, num_groups)
        mean = np.bincount(rows.group, weight * rows.residual, num_groups) / np.maximum(total, 1e-12)
        rest = rows.residual - mean[rows.group]
        sigma = max(1.4826 * float(np.median(np.abs(rest))), 0.01)
        weight = 1.0 / (1.0 + (rest / (robust * sigma)) ** 2) ** 2
    total = np.maximum(np.bincount(rows.group, weight, num_groups), 1e-12)
    known = share * total / sigma**2
    shrink = (known / (known + _CONSTANT_SIGMA**-2) / total)[rows.group]
    residual = rows.residual - shrink * np.bincount(rows.group, weight * rows.residual, num_groups)[rows.group]
    reduced = jacobian.copy()
    for column in range(jacobian.shape[1]):
        reduced[:, column] -= shrink * np.bincount(rows.group, weight * jacobian[:, column], num_groups)[rows.group]
    return residual, reduced, weight, sigma


def _covariance(
    normal: Float[np.ndarray, "parameters parameters"],
    scores: Float[np.ndarray, "blocks parameters"],
    prior: Float[np.ndarray, " parameters"],
    free: np.ndarray,
    num_blocks: int,
) -> Float[np.ndarray, "parameters parameters"]:
    """Covariance by blocks of time that disagree (sandwich estimate, White 1982), or by curvature if it is larger."""
    covariance = np.zeros((len(prior), len(prior)))
    if num_blocks == 0:
        return np.diag(np.where(free, np.inf, 0.0))
    inner = np.ix_(free, free)
    damped = normal + np.diag(prior)
    inverse = np.linalg.pinv(damped[inner], hermitian=True)
    spread = scores[:, free].T @ scores[:, free] + np.diag(prior)[inner]
    spread *= num_blocks / max(1.0, num_blocks - 1.0)
    sandwich = inverse @ spread @ inverse
    scale = np.sqrt(np.maximum(1.0, np.diag(inverse) / np.maximum(np.diag(sandwich), 1e-300)))
    covariance[inner] = sandwich * np.outer(scale, scale)
    return covariance
