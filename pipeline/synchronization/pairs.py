"""Pairs of cameras: how well people in motion agree with the epipolar geometry, by lag of one camera's clock."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Int

from pipeline.data import Camera, read_only
from pipeline.synchronization.motions import Motion

# Mean truncated cost, in 0 to 1, up to which two motions may be the same person.
_MAX_COST = 0.5
# Instants of a pair of cameras that are compared, over all of its motions.
_COMPARED = 600
# Path of a joint between two compared instants, in tolerances, that counts as a full observation.
_NOVEL_PATH = 1.0
# Grid points that two motions must share.
_MIN_SHARED = 8


@dataclass(frozen=True, slots=True, eq=False)
class PairCurve:
    """Agreement of two cameras by lag.

    Parameters
    ----------
    first, second
        Numbers of the cameras.
    lags
        Grid steps by which the second camera's own time is late: ``own time of first = own time of second + lag``.
    gain
        Weight of the joints that agree less that of the joints that don't, over the best matching of people.
    cost
        Mean truncated cost of the matched joints, in 0 to 1; NaN without a match.
    weight
        Weight of the matched joints: joints in motion times instants.
    """

    first: int
    second: int
    lags: Int[np.ndarray, " lags"]
    gain: Float[np.ndarray, " lags"]
    cost: Float[np.ndarray, " lags"]
    weight: Float[np.ndarray, " lags"]


def essential_matrix(first: Camera, second: Camera) -> Float[np.ndarray, "3 3"]:
    """Essential matrix ``E`` with ``x_second^T E x_first = 0`` on normalised image planes."""
    second_from_first = second.cam_from_world @ first.cam_from_world.inverse()
    x, y, z = second_from_first.translation_m
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ second_from_first.rotation


def compare_pair(
    cameras: Sequence[Camera], pair: tuple[int, int], motions: Sequence[Motion], lags: Int[np.ndarray, " lags"]
) -> PairCurve:
    """Compare the people of two cameras at many lags.

    A joint at rest agrees at every lag, so a joint counts as much as it moves. At each lag the motions are matched one
    to one, the best first.

    Parameters
    ----------
    lags
        Ascending.
    """
    left = [one for one in motions if one.camera == pair[0]]
    right = [one for one in motions if one.camera == pair[1]]
    value, cost, weight = _compare_all(cameras, left, right, lags)
    gain, total_cost, total = (np.zeros(len(lags)) for _ in range(3))
    for number, lag in enumerate(lags.tolist()):
        for a, b in match_motions(left, right, value[:, :, number], lag):
            gain[number] += value[a, b, number]
            total_cost[number] += cost[a, b, number]
            total[number] += weight[a, b, number]
    mean = np.divide(total_cost, total, out=np.full(len(lags), np.nan), where=total > 0)
    return PairCurve(*pair, lags, read_only(gain), read_only(mean), read_only(total))


def pair_values(
    cameras: Sequence[Camera], left: Sequence[Motion], right: Sequence[Motion], lags: Int[np.ndarray, " lags"]
) -> Float[np.ndarray, "left right lags"]:
    """Agreement of each motion of one camera with each motion of another one, at some lags."""
    return _compare_all(cameras, left, right, lags)[0]


def _compare_all(
    cameras: Sequence[Camera], left: Sequence[Motion], right: Sequence[Motion], lags: Int[np.ndarray, " lags"]
) -> tuple[Float[np.ndarray, "left right lags"], ...]:
    """Value, summed cost and weight of each pair of motions at each lag."""
    value = np.zeros((len(left), len(right), len(lags)))
    cost, weight = np.zeros_like(value), np.zeros_like(value)
    if left and right:
        essential = essential_matrix(cameras[left[0].camera], cameras[right[0].camera])
        stride = max(2, sum(len(one.points) for one in left) // _COMPARED)
        for a, first in enumerate(left):
            for b, second in enumerate(right):
                value[a, b], cost[a, b], weight[a, b] = _compare(essential, first, second, lags, stride)
    return value, cost, weight


def match_motions(
    left: Sequence[Motion], right: Sequence[Motion], value: Float[np.ndarray, "left right"], lag: int
) -> list[tuple[int, int]]:
    """Match motions one to one at each instant, those of the largest value first."""
    chosen: list[tuple[int, int]] = []
    rows, columns = np.nonzero(value > 0)
    for number in np.argsort(-value[rows, columns], kind="stable"):
        a, b = int(rows[number]), int(columns[number])
        shared = _shared(left[a], right[b], lag)
        if not any(
            (a == other[0]) != (b == other[1]) and _overlap(shared, _shared(left[other[0]], right[other[1]], lag))
            for other in chosen
        ):
            chosen.append((a, b))
    return chosen


def _shared(first: Motion, second: Motion, lag: int) -> range:
    """Grid points, on the first camera's time, that both motions have."""
    return range(max(first.first, second.first + lag), min(first.stop, second.stop + lag))


def _overlap(one: range, other: range) -> bool:
    return max(one.start, other.start) < min(one.stop, other.stop)


def _compare(
    essential: Float[np.ndarray, "3 3"], first: Motion, second: Motion, lags: Int[np.ndarray, " lags"], stride: int
) -> tuple[Float[np.ndarray, " lags"], Float[np.ndarray, " lags"], Float[np.ndarray, " lags"]]:
    """Value, summed cost and weight of two motions at each lag."""
    none = np.zeros(len(lags))
    instants = np.arange(-(-first.first // stride) * stride, first.stop, stride)
    rows = instants[None, :] - lags[:, None] - second.first
    is_shared = (rows >= 0) & (rows < len(second.points))
    used = is_shared.sum(1) * stride >= _MIN_SHARED
    if not used.any():
        return none, none, none
    rows = np.clip(rows[used], 0, len(second.points) - 1)
    # Single coordinates in separate arrays: NumPy adds them much faster than along a short last axis.
    first_lines = _epipolar_lines(first.points[instants - first.first], essential)
    second_lines = _epipolar_lines(second.points, essential.T)
    x, y = (np.ascontiguousarray(second.points[..., axis], np.float32)[rows] for axis in (0, 1))
    product = first_lines.x * x + first_lines.y * y + first_lines.z
    tolerance2 = np.float32((first.tolerance**2 + second.tolerance**2) / 2)
    cost = np.minimum(np.float32(1), product**2 / ((first_lines.norm2 + second_lines.norm2[rows]) * tolerance2))
    weight = (_novelty(first, stride)[instants - first.first] + _novelty(second, stride)[rows]) / 2
    weight *= np.isfinite(cost) & is_shared[used][..., None]
    total = weight.sum((1, 2), dtype=np.float64)
    of_cost = (weight * np.nan_to_num(cost)).sum((1, 2), dtype=np.float64)
    found = tuple(np.zeros(len(lags)) for _ in range(3))
    for column, values in zip(found, (total - of_cost / _MAX_COST, of_cost, total), strict=True):
        column[used] = values
    return found[0], found[1], found[2]


class _Lines(NamedTuple):
    """Epipolar lines ``x u + y v + z = 0`` of points in the other image, and the squared norms of ``(x, y)``."""

    x: Float32[np.ndarray, "n joints"]
    y: Float32[np.ndarray, "n joints"]
    z: Float32[np.ndarray, "n joints"]
    norm2: Float32[np.ndarray, "n joints"]


def _epipolar_lines(points: Float[np.ndarray, "n joints 2"], essential: Float[np.ndarray, "3 3"]) -> _Lines:
    x, y, z = np.moveaxis((points @ essential[:, :2].T + essential[:, 2]).astype(np.float32), -1, 0)
    return _Lines(np.ascontiguousarray(x), np.ascontiguousarray(y), np.ascontiguousarray(z), x * x + y * y)


def _novelty(motion: Motion, stride: int) -> Float32[np.ndarray, "steps joints"]:
    """Weight of each joint: its path between two compared instants, in tolerances, at most 1."""
    return np.nan_to_num(np.minimum(1.0, motion.path() * stride / _NOVEL_PATH)).astype(np.float32)
