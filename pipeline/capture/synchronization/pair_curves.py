"""Pairs of cameras: how well people in motion agree with the epipolar geometry, by lag of one camera's clock."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Int

from pipeline.capture.synchronization.motions import BodyMotion
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera

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
    """Agreement of two cameras by lag."""

    # Numbers of the cameras
    first: int
    second: int
    # Grid steps by which the second camera's own time is late: ``own time of first = own time of second + lag``
    lags: Int[np.ndarray, " lags"]
    # Weight of the joints that agree less the weight of the joints that don't, over the best matching of people
    gain: Float[np.ndarray, " lags"]
    cost: Float[np.ndarray, " lags"]  # Mean truncated cost of the matched joints, in 0 to 1; NaN without a match
    weight: Float[np.ndarray, " lags"]  # Weight of the matched joints: joints in motion times instants


def essential_matrix(first: Camera, second: Camera) -> Float[np.ndarray, "3 3"]:
    """Essential matrix ``E`` with ``x_second^T E x_first = 0`` on normalised image planes."""
    second_from_first = second.cam_from_world @ first.cam_from_world.inverse()
    x, y, z = second_from_first.translation_m
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ second_from_first.rotation


def compare_pair(
    cameras: Sequence[Camera], pair: tuple[int, int], motions: Sequence[BodyMotion], lags: Int[np.ndarray, " lags"]
) -> PairCurve:
    """Compare the people of two cameras at many lags.

    A joint at rest agrees at every lag, so a joint counts as much as it moves. At each lag the motions are matched one
    to one, the best first. Lags ascend.
    """
    left = [motion for motion in motions if motion.camera == pair[0]]
    right = [motion for motion in motions if motion.camera == pair[1]]
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
    cameras: Sequence[Camera], left: Sequence[BodyMotion], right: Sequence[BodyMotion], lags: Int[np.ndarray, " lags"]
) -> Float[np.ndarray, "left right lags"]:
    """Agreement of each motion of one camera with each motion of another one, at some lags."""
    return _compare_all(cameras, left, right, lags)[0]


def _compare_all(
    cameras: Sequence[Camera], left: Sequence[BodyMotion], right: Sequence[BodyMotion], lags: Int[np.ndarray, " lags"]
) -> tuple[Float[np.ndarray, "left right lags"], ...]:
    """Value, summed cost and weight of each pair of motions at each lag."""
    value = np.zeros((len(left), len(right), len(lags)))
    cost, weight = np.zeros_like(value), np.zeros_like(value)
    if left and right:
        essential = essential_matrix(cameras[left[0].camera], cameras[right[0].camera])
        stride = max(2, sum(len(motion.points) for motion in left) // _COMPARED)
        firsts, seconds = _prepare(left, essential, stride), _prepare(right, essential.T, stride)
        for a in range(len(left)):
            start = firsts.first[a] - seconds.stop + _MIN_SHARED
            stop = firsts.stop[a] - seconds.first - _MIN_SHARED
            meets = (start[:, None] <= lags) & (lags <= stop[:, None])
            # At one lag all motions are compared at once; at many lags each one by itself, to bound the memory.
            for group in np.arange(len(right))[None] if len(lags) == 1 else np.arange(len(right))[:, None]:
                row, lag = np.nonzero(meets[group])
                if len(row):
                    at = a, group[row], lag
                    value[at], cost[at], weight[at] = _compare(firsts, a, seconds, group[row], lags[lag], stride)
    return value, cost, weight


def match_motions(
    left: Sequence[BodyMotion], right: Sequence[BodyMotion], value: Float[np.ndarray, "left right"], lag: int
) -> list[tuple[int, int]]:
    """Match motions one to one at each instant, the largest value first."""
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


def _shared(first: BodyMotion, second: BodyMotion, lag: int) -> range:
    """Grid points, on the first camera's time, that both motions have."""
    return range(max(first.first, second.first + lag), min(first.stop, second.stop + lag))


def _overlap(first: range, second: range) -> bool:
    return max(first.start, second.start) < min(first.stop, second.stop)


class _Prepared(NamedTuple):
    """Motions of a camera, the weights of their joints, and epipolar lines ``u x + v y + w = 0`` in the other image.

    Points of all motions follow each other. Single coordinates are in separate arrays: NumPy adds them much faster than
    along a short last axis.
    """

    first: Int[np.ndarray, " motions"]  # Grid points
    stop: Int[np.ndarray, " motions"]
    begin: Int[np.ndarray, " motions"]  # Row of a motion's first point
    tolerance: Float[np.ndarray, " motions"]
    novelty: Float32[np.ndarray, "points joints"]
    x: Float32[np.ndarray, "points joints"]
    y: Float32[np.ndarray, "points joints"]
    u: Float32[np.ndarray, "points joints"]
    v: Float32[np.ndarray, "points joints"]
    w: Float32[np.ndarray, "points joints"]
    norm2: Float32[np.ndarray, "points joints"]


def _prepare(motions: Sequence[BodyMotion], essential: Float[np.ndarray, "3 3"], stride: int) -> _Prepared:
    """Prepare motions; a joint weighs as much as its path between two compared instants, in tolerances, at most 1."""
    first, stop, tolerance = map(np.array, zip(*((m.first, m.stop, m.tolerance) for m in motions), strict=True))
    points, path = (np.concatenate([getattr(m, name) for m in motions]) for name in ("points", "path"))
    lines = points @ essential[:, :2].T + essential[:, 2]
    x, y = (np.ascontiguousarray(points[..., axis], np.float32) for axis in (0, 1))
    u, v, w = (np.ascontiguousarray(lines[..., axis], np.float32) for axis in (0, 1, 2))
    novelty = np.nan_to_num(np.minimum(1.0, path * stride / _NOVEL_PATH)).astype(np.float32)
    begin = np.append(0, np.cumsum(stop - first)[:-1])
    return _Prepared(first, stop, begin, tolerance, novelty, x, y, u, v, w, u**2 + v**2)


def _compare(
    firsts: _Prepared,
    a: int,
    seconds: _Prepared,
    b: Int[np.ndarray, " pairs"],
    lags: Int[np.ndarray, " pairs"],
    stride: int,
) -> tuple[Float[np.ndarray, " pairs"], Float[np.ndarray, " pairs"], Float[np.ndarray, " pairs"]]:
    """Value, summed cost and weight of motion ``a`` with motions ``b`` at their lags."""
    start, length = seconds.first[b] + lags, (seconds.stop - seconds.first)[b, None]
    begin, end = max(firsts.first[a], start.min()), min(firsts.stop[a], int((start + length[:, 0]).max()))
    instants = np.arange(-(-begin // stride) * stride, end, stride)
    rows = instants - start[:, None]
    is_shared = (rows >= 0) & (rows < length)
    is_shared &= (is_shared.sum(1) * stride >= _MIN_SHARED)[:, None]
    rows = np.clip(rows, 0, length - 1) + seconds.begin[b, None]
    at = instants - firsts.first[a] + firsts.begin[a]
    product = firsts.u[at] * seconds.x[rows] + firsts.v[at] * seconds.y[rows] + firsts.w[at]
    tolerance2 = ((firsts.tolerance[a] ** 2 + seconds.tolerance[b] ** 2) / 2).astype(np.float32)[:, None, None]
    cost = np.minimum(np.float32(1), product**2 / ((firsts.norm2[at] + seconds.norm2[rows]) * tolerance2))
    weight = (firsts.novelty[at] + seconds.novelty[rows]) / 2
    weight *= np.isfinite(cost) & is_shared[..., None]
    total = weight.sum((1, 2), dtype=np.float64)
    of_cost = (weight * np.nan_to_num(cost)).sum((1, 2), dtype=np.float64)
    return total - of_cost / _MAX_COST, of_cost, total
