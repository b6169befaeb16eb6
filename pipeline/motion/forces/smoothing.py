"""Accelerations of measured positions, with their covariance.

A movement is a path whose jerk is white noise, seen with white noise: its most likely path minimises the squares of the
residuals and of the third differences (Whittaker 1923; as quintic splines in Woltring, "A Fortran package for
generalized, cross-validatory spline smoothing and differentiation", Adv. Eng. Softw. 8, 1986). The ratio of both noises
is the most likely one given the take itself (restricted maximum likelihood; Wahba, "A comparison of GCV and GML for
choosing the smoothing parameter", Ann. Statist. 13, 1985), but for a largest cutoff. The path's covariance is the
posterior (Wahba, "Bayesian confidence intervals for the cross-validated smoothing spline", J. R. Stat. Soc. B 45,
1983).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.optimize import minimize_scalar

from pipeline.motion.balance.compute import GRAVITY_M_S2

_ORDER = 3
_DIFFERENCE = np.array([-1.0, 3.0, -3.0, 1.0])
_SECOND = np.array([1.0, -2.0, 1.0])
# Frequency above which nothing but noise and skin moves a body's centre: the cutoff of Winter, "Biomechanics and Motor
# Control of Human Movement" (2009), section 3.4.4. Range of the logarithm of the penalty above the one of this cutoff.
_HIGHEST_HZ, _LOG_RANGE = 6.0, 15.0
# Deviation of a free fall, as a share of gravity.
_FALL_SHARE = 0.02
# Frames whose covariance is computed at once, and those at both ends that are there for the others' sake.
_BLOCK_FRAMES, _MARGIN_FRAMES = 192, 48


@dataclass(frozen=True, slots=True, eq=False)
class PathSmoother:
    """Smoother of positions over frames: linear, and the same for all positions."""

    known: Bool[np.ndarray, " frames"]  # Frames whose positions count
    penalty: float  # Square of the ratio of the noise of positions to the noise of third differences
    frame_rate_hz: float

    def path(self, values: Float[np.ndarray, "frames *columns"]) -> Float[np.ndarray, "frames *columns"]:
        """Most likely path of positions."""
        flat = values.reshape(len(values), -1)
        # Far from the world's origin, small movements need all digits.
        middle = flat[self.known].mean(0)
        flat = np.where(self.known[:, None], flat - middle, 0.0)
        factor = cholesky_banded(_bands(self.known, self.penalty))
        return np.asarray(cho_solve_banded((factor, False), flat) + middle).reshape(values.shape)

    def path_with_falls(
        self, values: Float[np.ndarray, "frames 3"], sigma_m: float, falls: Bool[np.ndarray, " frames"]
    ) -> Float[np.ndarray, "frames 3"]:
        """Most likely path of a body that falls freely in some frames."""
        rate2 = self.frame_rate_hz**2
        inner = np.flatnonzero(falls[1:-1]) + 1
        weight = (sigma_m * rate2 / (_FALL_SHARE * GRAVITY_M_S2)) ** 2
        bands = _bands(self.known, self.penalty)
        middle = values[self.known].mean(0)
        right = np.where(self.known[:, None], values - middle, 0.0)
        for first, own in enumerate(_SECOND):
            right[inner - 1 + first] += weight * own * np.array([0.0, 0.0, -GRAVITY_M_S2]) / rate2
            for second in range(first, 3):
                bands[_ORDER - (second - first), inner - 1 + second] += weight * own * _SECOND[second]
        return np.asarray(cho_solve_banded((cholesky_banded(bands), False), right) + middle)

    def acceleration(self, path: Float[np.ndarray, "frames *columns"]) -> Float[np.ndarray, "frames *columns"]:
        """Second derivatives of a path; the first and the last frame have their neighbour's."""
        inner = (path[2:] - 2.0 * path[1:-1] + path[:-2]) * self.frame_rate_hz**2
        return np.concatenate([inner[:1], inner, inner[-1:]])

    def acceleration_gains(self, correlation: Float[np.ndarray, " lags"]) -> Float[np.ndarray, "frames 2"]:
        """Standard deviations of an acceleration for noise of positions of standard deviation 1.

        Two kinds of noise: white noise, by the posterior; and noise that lasts over frames, by its autocorrelation,
        which the path follows.
        """
        num_frames, step = len(self.known), _BLOCK_FRAMES - 2 * _MARGIN_FRAMES
        gains, blocks = np.empty((num_frames, 2)), dict[bytes, np.ndarray]()
        for start in range(0, max(num_frames - 2 * _MARGIN_FRAMES, 1), step):
            known = self.known[start : start + _BLOCK_FRAMES]
            of_block = blocks.setdefault(known.tobytes(), np.empty(0))
            if not len(of_block):
                of_block = blocks[known.tobytes()] = self._block_gains(known, correlation)
            first = _MARGIN_FRAMES if start else 0
            gains[start + first : start + len(known)] = of_block[first:]
        return gains

    def _block_gains(
        self, known: Bool[np.ndarray, " frames"], correlation: Float[np.ndarray, " lags"]
    ) -> Float[np.ndarray, "frames 2"]:
        size = len(known)
        differences = _differences(size, _DIFFERENCE)
        inverse = np.linalg.inv(np.diag(known + 1e-9) + self.penalty * differences.T @ differences)
        second = _differences(size, _SECOND) * self.frame_rate_hz**2
        inner = second @ inverse
        posterior = (inner * second).sum(1)
        apart = np.abs(np.arange(size)[:, None] - np.arange(size))
        alike = np.append(correlation, 0.0)[np.minimum(apart, len(correlation))]
        weights = inner * known
        lasting = ((weights @ alike) * weights).sum(1)
        rows = np.clip(np.arange(size) - 1, 0, size - 3)
        return np.asarray(np.sqrt(np.stack([posterior, lasting], axis=1)[rows].clip(0.0)))


def penalty_of(cutoff_hz: float, frame_rate_hz: float) -> float:
    """Penalty whose path halves movements of a frequency.

    >>> round(penalty_of(10.0, 60.0), 6)
    1.0
    """
    return float((2.0 * np.sin(np.pi * min(cutoff_hz / frame_rate_hz, 0.5))) ** -6)


def likeliest(
    values: Float[np.ndarray, "frames columns"], known: Bool[np.ndarray, " frames"], frame_rate_hz: float
) -> tuple[PathSmoother, float]:
    """Smoother with the most likely penalty for positions, and the standard deviation of their noise.

    All columns have the same noise and the same liveliness.
    """
    values = np.where(known[:, None], values - values[known].mean(0), 0.0)
    num_free = (int(known.sum()) - _ORDER) * values.shape[1]

    def noise(log_penalty: float) -> tuple[float, float]:
        factor = cholesky_banded(_bands(known, float(np.exp(log_penalty))))
        path = cho_solve_banded((factor, False), values)
        square = max(float((values * (values - path)).sum()), 1e-30)
        log_determinant = 2.0 * np.log(factor[-1]).sum() - (len(known) - _ORDER) * log_penalty
        return square, num_free * np.log(square) + values.shape[1] * log_determinant

    least = float(np.log(penalty_of(_HIGHEST_HZ, frame_rate_hz)))
    # The likelihood may have several maxima: the best one of a grid is refined.
    grid = least + np.arange(0.0, _LOG_RANGE, 1.5)
    best = grid[np.argmin([noise(log)[1] for log in grid])]
    bounds = max(best - 1.5, least), best + 1.5
    optimum = minimize_scalar(lambda log: noise(log)[1], bounds=bounds, method="bounded", options={"xatol": 0.02})
    return PathSmoother(known, float(np.exp(optimum.x)), frame_rate_hz), float(np.sqrt(noise(optimum.x)[0] / num_free))


def _bands(known: Bool[np.ndarray, " frames"], penalty: float) -> Float[np.ndarray, "4 frames"]:
    """Upper bands of the positions' weights and of the penalty on third differences."""
    bands = np.zeros((_ORDER + 1, len(known)))
    for first, weight in enumerate(_DIFFERENCE):
        for second in range(first, _ORDER + 1):
            bands[_ORDER - (second - first), second : len(known) - _ORDER + second] += (
                penalty * weight * _DIFFERENCE[second]
            )
    bands[-1] += known + 1e-9
    return bands


def _differences(num_frames: int, weights: Float[np.ndarray, " weights"]) -> Float[np.ndarray, "steps frames"]:
    """Matrix that takes differences of successive values."""
    matrix = np.zeros((num_frames - len(weights) + 1, num_frames))
    rows = np.arange(len(matrix))
    for shift, weight in enumerate(weights):
        matrix[rows, rows + shift] = weight
    return matrix
