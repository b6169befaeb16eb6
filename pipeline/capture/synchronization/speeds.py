"""Lags of two cameras from the speeds of people alone, without geometry: where to look beyond small offsets."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy import fft

from pipeline.capture.synchronization.motions import STEP_S, BodyMotion

# Grid steps of a sample of the speeds.
_SAMPLE = 5
# Samples that two cameras must share, and peaks of the correlation that are tried.
_MIN_SHARED, _PEAKS = 30, 4


def likely_lags(motions: Sequence[BodyMotion], pair: tuple[int, int]) -> list[int]:
    """Lags in grid steps at which the speeds in two cameras correlate best, over all lags, the best first.

    Speeds are summed over people, as multiples of the body's height: of all joints, and of their vertical parts, which
    look much the same from all sides. Their logarithms are compared, so that no jump outweighs the rest.
    """
    signals = [_signals([motion for motion in motions if motion.camera == camera]) for camera in pair]
    (first, first_start), (second, second_start) = signals
    if not len(first) or not len(second):
        return []
    number, total = np.arange(len(first) + len(second) - 1), len(first) + len(second)
    shared = np.minimum(np.minimum(number + 1, total - 1 - number), min(len(first), len(second)))
    correlation = np.zeros(len(shared))
    for column in range(first.shape[1]):
        a, b = (signal[:, column] - signal[:, column].mean() for signal in (first, second))
        norm = max(float(np.std(a) * np.std(b)), 1e-12)
        correlation = correlation + _correlate(a, b) / norm
    # As many standard deviations as chance would give: the sum of n products of independent numbers is about sqrt(n).
    score = np.where(shared >= _MIN_SHARED, correlation / np.sqrt(shared), -np.inf)
    lags = (np.arange(len(score)) - (len(second) - 1) + first_start - second_start) * _SAMPLE
    is_peak = np.r_[True, score[1:] >= score[:-1]] & np.r_[score[:-1] > score[1:], True] & np.isfinite(score)
    peaks = np.flatnonzero(is_peak)
    return [int(lag) for lag in lags[peaks[np.argsort(-score[peaks], kind="stable")]][:_PEAKS]]


def _correlate(a: Float[np.ndarray, " first"], b: Float[np.ndarray, " second"]) -> Float[np.ndarray, " lags"]:
    """Correlation at all lags, by Fourier transform since a session may have a pause of hours.

    As ``scipy.signal.correlate``, whose import takes as long as the rest of the check of a short take.
    """
    num_lags = len(a) + len(b) - 1
    num = fft.next_fast_len(num_lags, real=True)
    return np.asarray(fft.irfft(fft.rfft(a, num) * fft.rfft(b[::-1], num), num)[:num_lags])


def _signals(motions: Sequence[BodyMotion]) -> tuple[Float[np.ndarray, "samples channels"], int]:
    """Logarithms of the summed speeds, and the number of the first sample."""
    if not motions:
        return np.empty((0, 2)), 0
    start = min(motion.first for motion in motions) // _SAMPLE
    stop = max(motion.stop for motion in motions) // _SAMPLE + 1
    total = np.zeros(((stop - start) * _SAMPLE, 2))
    for motion in motions:
        rows = slice(motion.first - start * _SAMPLE, motion.stop - start * _SAMPLE)
        for column, speed in enumerate((np.linalg.norm(motion.speed, axis=-1), np.abs(motion.speed[..., 1]))):
            total[rows, column] += np.nan_to_num(np.mean(np.nan_to_num(speed), axis=-1)) / motion.tolerance * STEP_S
    return np.log1p(total.reshape(stop - start, _SAMPLE, 2).mean(1) * 10.0), start
