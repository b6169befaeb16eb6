"""Coarse offsets of all cameras: the lags at which most people in motion agree, over all pairs of cameras."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from pipeline.capture.synchronization.pairs import PairCurve

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


def splits_of(curves: Sequence[PairCurve], num_cameras: int) -> list[frozenset[int]]:
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
    """Tree of the best pairs, with their lags; a forest if some cameras agree with nobody."""
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
