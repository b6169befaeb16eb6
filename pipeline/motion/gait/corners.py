"""Corners of paths: the instant between two frames at which a resting point begins to move, or comes to rest."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

# Steps between tried instants, as a share of a frame.
_STEP = 0.05
# Noise lasts over frames: so many frames count as one independent measurement.
_FRAMES_PER_MEASUREMENT = 3.0
# Smallest noise of a position, which the precision of numbers and of the model leaves.
_LEAST_NOISE_M = 5e-4


class Corner(NamedTuple):
    """Instant at which a point's rest begins or ends."""

    row: float  # Row of the path, with its fraction
    sigma_rows: float  # Standard deviation of the row
    speed_m_s: float  # Speed with which the point arrives or leaves, of the model


def rest_ends(path_m: Float[np.ndarray, " frames"], frame_rate_hz: float, *, has_speed: bool) -> Corner | None:
    """Fit the end of a rest: constant until an instant t0, then ``a (t - t0)^2 + c (t - t0)^3``.

    A point that may leave with a speed has ``b (t - t0)`` in place of the cubic term. Least squares over the whole
    path, with t0 tried in steps of a twentieth of a frame: the instant lies between
    frames where the data allow. The standard deviation is that of t0 in the linearised problem, from the residuals.

    Parameters
    ----------
    path_m
        Positions along one direction, at rest at the start and moving to larger values at the end.
    has_speed
        Whether the point may leave with a speed, as in a jump; otherwise it only accelerates, as a toe that leaves the
        floor in gait.

    Returns
    -------
        Corner; ``None`` for paths of fewer than six frames, or if the point never moves.
    """
    num_frames = len(path_m)
    if num_frames < 6:
        return None
    rows = np.arange(num_frames, dtype=float)
    tried = np.arange(1.0, num_frames - 3.0, _STEP)
    since_s = np.maximum(rows - tried[:, None], 0.0) / frame_rate_hz
    columns = [np.ones_like(since_s), since_s**2, since_s if has_speed else since_s**3]
    design = np.stack(columns, axis=-1)
    transposed = design.swapaxes(1, 2)
    normal = transposed @ design + 1e-12 * np.eye(design.shape[-1])
    solution = np.linalg.solve(normal, transposed @ path_m[:, None])
    residual_m = path_m - (design @ solution)[..., 0]
    error = (residual_m**2).sum(-1)
    growing = solution[:, 1, 0] > 0 if not has_speed else solution[:, 2, 0] > 0
    if not growing.any():
        return None
    best = int(np.where(growing, error, np.inf).argmin())
    acceleration = solution[best, 1, 0]
    speed, jerk = (solution[best, 2, 0], 0.0) if has_speed else (0.0, solution[best, 2, 0])
    moved_s = since_s[best]
    by_instant = -np.where(moved_s > 0, speed + 2 * acceleration * moved_s + 3 * jerk * moved_s**2, 0.0)
    jacobian = np.column_stack([design[best], by_instant])
    noise = max(float(np.sqrt(error[best] / max(num_frames - jacobian.shape[1], 1))), _LEAST_NOISE_M)
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * noise**2 * _FRAMES_PER_MEASUREMENT
    sigma_rows = float(np.sqrt(max(covariance[-1, -1], 0.0))) * frame_rate_hz
    return Corner(float(tried[best]), sigma_rows, float(speed))


def rest_begins(path_m: Float[np.ndarray, " frames"], frame_rate_hz: float, *, has_speed: bool) -> Corner | None:
    """Fit the start of a rest: ``rest_ends`` of the path backwards.

    ``path_m`` moves to larger values at first, and is at rest at the end.
    """
    corner = rest_ends(-(path_m[::-1] - path_m[-1]), frame_rate_hz, has_speed=has_speed)
    return None if corner is None else corner._replace(row=len(path_m) - 1 - corner.row)
