"""Coarse offsets of all cameras: the lags at which most people in motion agree, over all pairs of cameras."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy import fft

from pipeline.capture.synchronization.motions import STEP_S, BodyMotion
from pipeline.capture.synchronization.pair_curves import PairCurve

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


_MAX_MOVES = 20


@dataclass(frozen=True, slots=True, eq=False)
class CameraSplit:
    """Cameras on one side of a split of all cameras, and the agreement across it if their clocks are shifted."""

    cameras: frozenset[int]  # Numbers of the cameras that are shifted together
    shifts: Int[np.ndarray, " shifts"]  # Shifts in grid steps, ascending
    gain: Float[np.ndarray, " shifts"]  # Agreement of the shifted cameras with the others


def solve_offsets(curves: Sequence[PairCurve], num_cameras: int) -> Int[np.ndarray, " cameras"]:
    """Offsets with the largest sum of agreement over all pairs, in grid steps.

    The best lags of pairs span a tree, the best pairs first (Kruskal 1956). Then cameras, and halves of the tree, are
    shifted while the sum grows. Returns the offset of each camera's own time from camera 0's; 0 for cameras that
    no pair links.
    """
    tree = _tree(curves, num_cameras)
    offsets = _along(tree, num_cameras)
    splits = list(_splits(tree, num_cameras))
    for _ in range(_MAX_MOVES):
        moved = False
        for cameras in splits:
            split = shift_curve(curves, offsets, cameras)
            if not len(split.shifts):
                continue
            best = int(np.argmax(split.gain))
            now = float(split.gain[split.shifts == 0].max(initial=0.0))
            if split.gain[best] > now * (1 + 1e-9) + 1e-9:
                offsets[list(cameras)] += split.shifts[best]
                moved = True
        if not moved:
            break
    return offsets - offsets[0]


def find_splits(curves: Sequence[PairCurve], num_cameras: int) -> list[frozenset[int]]:
    """Groups of cameras whose clocks may be wrong together: single cameras, and halves of the tree of best pairs."""
    return list(_splits(_tree(curves, num_cameras), num_cameras))


def shift_curve(
    curves: Sequence[PairCurve], offsets: Int[np.ndarray, " cameras"], cameras: frozenset[int]
) -> CameraSplit:
    """Agreement of some cameras with the others, over shifts of their clocks."""
    total: dict[int, float] = {}
    for curve in curves:
        if (curve.first in cameras) == (curve.second in cameras):
            continue
        sign = 1 if curve.second in cameras else -1
        shifts = sign * (curve.lags - (offsets[curve.second] - offsets[curve.first]))
        for shift, gain in zip(shifts.tolist(), curve.gain.tolist(), strict=True):
            total[shift] = total.get(shift, 0.0) + gain
    ordered = sorted(total)
    return CameraSplit(cameras, np.array(ordered, np.int64), np.array([total[shift] for shift in ordered]))


def _tree(curves: Sequence[PairCurve], num_cameras: int) -> list[tuple[int, int, int]]:
    """Tree of the best pairs, with their lags; a forest if some cameras agree with no other."""
    group = np.arange(num_cameras)
    tree = []
    for curve in sorted(curves, key=lambda candidate: -candidate.gain.max(initial=0.0)):
        if curve.gain.max(initial=0.0) > 0 and group[curve.first] != group[curve.second]:
            group[group == group[curve.second]] = group[curve.first]
            tree.append((curve.first, curve.second, int(curve.lags[np.argmax(curve.gain)])))
    return tree


def _along(tree: Sequence[tuple[int, int, int]], num_cameras: int) -> Int[np.ndarray, " cameras"]:
    offsets = np.zeros(num_cameras, np.int64)
    group = np.arange(num_cameras)
    for first, second, lag in tree:
        joined = group == group[second]
        offsets[joined] += offsets[first] + lag - offsets[second]
        group[joined] = group[first]
    return offsets


def _splits(tree: Sequence[tuple[int, int, int]], num_cameras: int) -> Iterator[frozenset[int]]:
    """Single cameras, and the side without camera 0 of each edge of the tree, each once."""
    splits = {frozenset([number]) for number in range(num_cameras)}
    yield from sorted(splits, key=min)
    everybody = frozenset(range(num_cameras))
    for number in range(len(tree)):
        side = _reached(tree[number][1], [edge for k, edge in enumerate(tree) if k != number])
        side = everybody - side if 0 in side else side
        if side not in splits and everybody - side not in splits:
            splits.add(side)
            yield side


def _reached(start: int, edges: Sequence[tuple[int, int, int]]) -> frozenset[int]:
    reached = {start}
    while more := {b for a, b in _both_ways(edges) if a in reached} - reached:
        reached |= more
    return frozenset(reached)


def _both_ways(edges: Sequence[tuple[int, int, int]]) -> Iterator[tuple[int, int]]:
    for first, second, _ in edges:
        yield first, second
        yield second, first
