"""Onsets of sound, and the lag between the sounds of two cameras: arrays in, arrays out."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d, uniform_filter1d

_MS = 1000
# An onset is a rise of the loudness over the time before; onsets are as wide as echoes and the rounding of times are.
_SHORT_MS, _BEFORE_MS, _WIDTH_MS = 4, 25, 2.0
# Rise (decades of energy) from which a sound is an onset, and how many there must be.
_RISE, _MIN_ONSETS = 0.5, 4
_BIN_MS = 10
# The best lag is so many standard deviations above the others, and the next best one this share of it at most.
_MIN_SCORE, _MAX_RIVAL, _RIVAL_MS = 8.0, 0.7, 60
_MIN_SHARED_MS = 2000
# Windows in which the lag is measured finely, around the coarse one.
_WINDOW_MS, _REACH_MS, _MIN_CORRELATION = 20_000, 80, 0.2
# Windows from which a drift is measured, and the largest one of real clocks.
_MIN_WINDOWS, _MIN_SPAN_S, _MAX_DRIFT = 4, 60.0, 5e-4
_MIN_SIGMA_S = 0.0005


@dataclass(frozen=True, slots=True)
class Lag:
    """Lag between two cameras: ``time in the first = time in the second + lag_s + drift * (that - middle_s)``."""

    # Lag at ``middle_s``, a time of the second camera, and its change
    lag_s: float
    drift: float
    middle_s: float
    sigma_s: float  # Standard deviation, from how much parts of the take disagree
    score: float  # Standard deviations by which the lag fits better than others


def onset_strength(energy: Float[np.ndarray, " ms"]) -> Float[np.ndarray, " ms"] | None:
    """Strength of onsets in each millisecond, decades of energy; ``None`` if there are few, as in silence.

    ``energy`` is the energy of each millisecond.
    """
    energy = np.asarray(energy, np.float64)
    if len(energy) < _MIN_SHARED_MS or not energy.max(initial=0.0) > 0:
        return None
    floor = max(float(np.percentile(energy, 20.0)), 1e-7 * float(energy.max()))
    level = np.log10(uniform_filter1d(energy, _SHORT_MS, origin=-(_SHORT_MS // 2)) + floor)
    before = uniform_filter1d(level, _BEFORE_MS, origin=(_BEFORE_MS - 1) // 2 - 0)
    rise = np.maximum(level - np.roll(before, 1), 0.0)
    rise[:1] = 0.0
    rise[rise < _RISE] = 0.0
    starts = np.flatnonzero((rise[1:] > 0) & (rise[:-1] == 0))
    if len(starts) < _MIN_ONSETS:
        return None
    return np.asarray(gaussian_filter1d(rise, _WIDTH_MS), np.float64)


def find_lag(first: Float[np.ndarray, " m"], second: Float[np.ndarray, " n"]) -> Lag | None:
    """Lag at which the onsets of two cameras agree best; ``None`` if no lag is clearly better than all others.

    The cross-correlation over all lags gives the coarse lag. It is measured finely in windows of 20 s, whose median is
    the lag; of takes of a minute or more a line through the windows (Theil-Sen) gives the drift too.
    """
    coarse = _coarse_lag(_binned(first), _binned(second))
    if coarse is None:
        return None
    lag_ms, score = coarse[0] * _BIN_MS, coarse[1]
    places, lags = _windows(first, second, lag_ms)
    if not len(lags):
        return None
    drift = 0.0
    middle_ms = float(np.median(places))
    if len(lags) >= _MIN_WINDOWS and (places[-1] - places[0]) / _MS >= _MIN_SPAN_S:
        left, right = np.triu_indices(len(lags), 1)
        drift = float(np.median((lags[right] - lags[left]) / (places[right] - places[left])))
        if abs(drift) > _MAX_DRIFT:
            return None
    rest = lags - drift * (places - middle_ms)
    spread = 1.4826 * float(np.median(np.abs(rest - np.median(rest))))
    sigma_s = max(spread / np.sqrt(len(rest)) / _MS, _MIN_SIGMA_S)
    return Lag(float(np.median(rest)) / _MS, drift, middle_ms / _MS, sigma_s, score)


def _binned(strength: Float[np.ndarray, " ms"]) -> Float[np.ndarray, " bins"]:
    """Strongest onset of each bin of 10 ms, without the mean."""
    num_bins = len(strength) // _BIN_MS
    bins = strength[: num_bins * _BIN_MS].reshape(num_bins, _BIN_MS).max(1)
    return np.asarray(bins - bins.mean(), np.float64)


def _coarse_lag(first: Float[np.ndarray, " m"], second: Float[np.ndarray, " n"]) -> tuple[int, float] | None:
    """Best lag in bins and its score."""
    from scipy.signal import correlate  # noqa: PLC0415 - slow to import, and seldom needed

    together = correlate(first, second, "full", method="fft")
    lags = np.arange(len(together)) - (len(second) - 1)
    # The part that both recorded, of each lag.
    begin, end = np.maximum(lags, 0), np.minimum(len(first), len(second) + lags)
    shared = end - begin
    energies = [np.r_[0.0, np.cumsum(signal**2)] for signal in (first, second)]
    norm = (energies[0][end] - energies[0][begin]) * (energies[1][end - lags] - energies[1][begin - lags])
    is_known = (shared * _BIN_MS >= _MIN_SHARED_MS) & (norm > 1e-9 * norm.max(initial=0.0))
    if not is_known.any():
        return None
    score = np.where(is_known, together / np.sqrt(np.where(is_known, norm, 1.0)) * np.sqrt(shared), -np.inf)
    known = score[is_known]
    spread = 1.4826 * float(np.median(np.abs(known - np.median(known))))
    best = int(np.argmax(score))
    apart = np.abs(lags - lags[best]) * _BIN_MS > _RIVAL_MS
    rival = float(score[apart & is_known].max(initial=0.0))
    value = float(score[best])
    if not value >= _MIN_SCORE * max(spread, 1e-12) or rival > _MAX_RIVAL * value:
        return None
    return int(lags[best]), value / max(spread, 1e-12)


def _windows(
    first: Float[np.ndarray, " m"], second: Float[np.ndarray, " n"], lag_ms: int
) -> tuple[Float[np.ndarray, " windows"], Float[np.ndarray, " windows"]]:
    """Middle of each window in the second camera's time, and the lag in it, both in ms."""
    from scipy.signal import correlate  # noqa: PLC0415 - slow to import, and seldom needed

    places, lags = [], []
    begin = max(0, _REACH_MS - lag_ms)
    end = min(len(second), len(first) - lag_ms - _REACH_MS)
    count = max(1, (end - begin) // _WINDOW_MS)
    for number in range(count):
        low, high = begin + number * (end - begin) // count, begin + (number + 1) * (end - begin) // count
        ours = second[low:high]
        theirs = first[low + lag_ms - _REACH_MS : high + lag_ms + _REACH_MS]
        if high - low < _MIN_SHARED_MS // 2 or not ours.any():
            continue
        together = correlate(theirs, ours, "valid", method="fft")
        energy = np.r_[0.0, np.cumsum(theirs**2)]
        norm = np.sqrt((energy[len(ours) :] - energy[: len(energy) - len(ours)]) * float(ours @ ours))
        value = together / np.maximum(norm, 1e-9 * norm.max(initial=1e-300))
        best = int(np.argmax(value))
        if value[best] >= _MIN_CORRELATION and 0 < best < len(value) - 1:
            left, top, right = value[best - 1 : best + 2]
            curve = left - 2.0 * top + right
            part = 0.5 * (left - right) / curve if curve < 0 else 0.0
            places.append((low + high) / 2.0)
            lags.append(lag_ms + best + float(part) - _REACH_MS)
    return np.array(places), np.array(lags)
