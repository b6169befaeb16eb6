"""Relative poses of two cameras from people in both views, without knowing who is who.

Each pair of tracklets proposes an essential matrix, with RANSAC (Nister 2004, "An efficient solution to the five-point
relative pose problem"). The one to which most of all pairs of tracklets fit, one to one at each instant, decides who is
who: two cameras see the same joints on the same epipolar planes all the time, and others only by chance.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.calibration.people.following import JOINTS
from pipeline.calibration.people.tracklets import MIN_INSTANTS, ViewTracklet
from pipeline.core.data.arrays import read_only
from pipeline.core.data.rigid import Rigid3

# Error of a joint that still fits, as a share of the body's height in the image, and in pixels at least.
_TOLERANCE, _MIN_TOLERANCE_PX = 0.05, 4.0
# Mean truncated cost, in 0 to 1, up to which two tracklets may be the same person.
MAX_COST = 0.5
# Proposals that are tried; instants of a pair of tracklets that are compared; points of a proposal.
_PROPOSALS, _COMPARED, _DRAWN = 24, 60, 400
_REFINEMENTS = 3
_SEED = 20


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """Two tracklets, by their numbers, that are one person; ``support`` is the number of instants that fit."""

    first: int
    second: int
    support: float


@dataclass(frozen=True, slots=True, eq=False)
class RelativePose:
    """Relative pose of two cameras up to scale."""

    # Numbers of the cameras
    first: int
    second: int
    second_from_first: Rigid3  # Transform; its translation has length 1
    matches: tuple[Match, ...]  # Tracklets that are one person
    support: float  # Instants of people that fit
    angle_deg: float  # Median angle between the rays to a joint
    cost: float  # Mean truncated cost of the joints that the matches compare


@dataclass(frozen=True, slots=True, eq=False)
class _Compared:
    """Points of all pairs of tracklets of two cameras that overlap in time."""

    tracklets: Int[np.ndarray, "pairs 2"]  # Numbers of the two tracklets of each pair
    overlap: Float[np.ndarray, " pairs"]  # Number of instants that the pair shares
    owner: Int[np.ndarray, " n"]  # Pair of each point
    # Points on the normalised image planes
    left: Float[np.ndarray, "n 2"]
    right: Float[np.ndarray, "n 2"]
    tolerance: Float[np.ndarray, " n"]  # Sampson distance up to which a point fits


def relate_by_people(
    cameras: tuple[int, int], tracklets: Sequence[ViewTracklet], focal_px: Float[np.ndarray, " cameras"]
) -> RelativePose | None:
    """Find the relative pose of two cameras and the tracklets that are the same people; ``None`` if there is none."""
    compared = _compare(cameras, tracklets, focal_px)
    if compared is None:
        return None
    order = np.argsort(-_alikeness(compared, tracklets))[:_PROPOSALS]
    best: tuple[float, np.ndarray] = 0.0, np.empty(0)
    for number in order:
        matrix = _essential(compared, np.array([number]))
        if matrix is None:
            continue
        support = _support(compared, tracklets, matrix)
        for _ in range(_REFINEMENTS):
            chosen = np.array([pair for pair, _ in support], int)
            better = _essential(compared, chosen) if len(chosen) else None
            better_support = [] if better is None else _support(compared, tracklets, better)
            if better is None or _total(better_support) <= _total(support):
                break
            matrix, support = better, better_support
        if _total(support) > best[0]:
            best = _total(support), matrix
    return _posed(cameras, compared, tracklets, best[1]) if best[0] >= MIN_INSTANTS else None


def _compare(
    cameras: tuple[int, int], tracklets: Sequence[ViewTracklet], focal_px: Float[np.ndarray, " cameras"]
) -> _Compared | None:
    sides = [[n for n, tracklet in enumerate(tracklets) if tracklet.camera == camera] for camera in cameras]
    pairs: list[tuple[int, int]] = []
    overlaps, owners, lefts, rights, tolerances = [], [], [], [], []
    for first in sides[0]:
        for second in sides[1]:
            left, right = tracklets[first], tracklets[second]
            shared = left.shared(right)
            if len(shared) < MIN_INSTANTS:
                continue
            chosen = np.asarray(shared)[:: max(1, len(shared) // _COMPARED)]
            a, b = left.ideal[left.rows(chosen)], right.ideal[right.rows(chosen)]
            is_known = (np.isfinite(a) & np.isfinite(b)).all(-1)
            if is_known.sum() < 5 * MIN_INSTANTS:
                continue
            sides_px = [max(_TOLERANCE * side.height_px, _MIN_TOLERANCE_PX) for side in (left, right)]
            sigma = [side_px / focal_px[camera] for side_px, camera in zip(sides_px, cameras, strict=True)]
            owners.append(np.full(is_known.sum(), len(pairs)))
            tolerances.append(np.full(is_known.sum(), np.hypot(*sigma) / np.sqrt(2)))
            pairs.append((first, second))
            overlaps.append(float(len(shared)))
            lefts.append(a[is_known])
            rights.append(b[is_known])
    if not pairs:
        return None
    return _Compared(np.array(pairs), np.array(overlaps), *map(np.concatenate, (owners, lefts, rights, tolerances)))


def _alikeness(compared: _Compared, tracklets: Sequence[ViewTracklet]) -> Float[np.ndarray, " pairs"]:
    """How alike two bodies move, times the instants that they share.

    Heights of joints above the hips along the body, in lengths of the body, look much the same from all sides; so does
    their change over time.
    """
    heights = {number: _heights(tracklets[number]) for number in np.unique(compared.tracklets)}
    alike = np.zeros(len(compared.overlap))
    for number, (first, second) in enumerate(compared.tracklets):
        left, right = tracklets[first], tracklets[second]
        shared = left.shared(right)
        a, b = heights[first][left.rows(shared)], heights[second][right.rows(shared)]
        both = np.isfinite(a) & np.isfinite(b)
        a, b = a - _medians(a, both), b - _medians(b, both)
        change, spread = np.abs(a - b)[both].sum(), (np.abs(a) + np.abs(b))[both].sum()
        alike[number] = 1.0 - change / max(float(spread), 1e-9)
    return np.maximum(alike, 0.01) * np.sqrt(compared.overlap)


def _medians(
    values: Float[np.ndarray, "instants joints"], used: Bool[np.ndarray, "instants joints"]
) -> Float[np.ndarray, " joints"]:
    """Median of the used values of each joint; 0 where there is none."""
    chosen = [column[mask] for column, mask in zip(values.T, used.T, strict=True)]
    return np.array([np.median(values_of_joint) if len(values_of_joint) else 0.0 for values_of_joint in chosen])


def _heights(tracklet: ViewTracklet) -> Float[np.ndarray, "instants joints"]:
    index = {name: number for number, name in enumerate(JOINTS)}
    points = tracklet.ideal
    hips = points[:, [index["left_hip"], index["right_hip"]]].mean(1)
    shoulders = points[:, [index["left_shoulder"], index["right_shoulder"]]].mean(1)
    trunk = (shoulders - hips)[np.isfinite(shoulders - hips).all(-1)]
    if not len(trunk):
        return np.full(points.shape[:2], np.nan)
    axis = np.median(trunk, axis=0)
    heights: np.ndarray = (points - hips[:, None]) @ (axis / max(float(axis @ axis), 1e-12))
    return heights


def sampson(
    essential: Float[np.ndarray, "3 3"], left: Float[np.ndarray, "n 2"], right: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, " n"]:
    """Sampson distance of points to ``right^T E left = 0`` (Hartley and Zisserman 2004, eq. 11.9), without unit."""
    to_right = left @ essential[:, :2].T + essential[:, 2]
    to_left = right @ essential[:2] + essential[2]
    product = (right * to_right[:, :2]).sum(-1) + to_right[:, 2]
    return np.abs(product) / np.sqrt((to_right[:, :2] ** 2).sum(-1) + (to_left[:, :2] ** 2).sum(-1))


def _costs(compared: _Compared, essential: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, " pairs"]:
    """Mean truncated cost of each pair of tracklets."""
    cost = np.minimum(1.0, (sampson(essential, compared.left, compared.right) / compared.tolerance) ** 2)
    counts = np.bincount(compared.owner, minlength=len(compared.overlap))
    return np.bincount(compared.owner, cost, len(compared.overlap)) / counts


def _support(
    compared: _Compared, tracklets: Sequence[ViewTracklet], essential: Float[np.ndarray, "3 3"]
) -> list[tuple[int, float]]:
    """Pairs of tracklets that fit, best first, and their support: at no instant has a tracklet two partners."""
    cost = _costs(compared, essential)
    value = compared.overlap * (1.0 - cost / MAX_COST)
    chosen: list[tuple[int, float]] = []
    for number in np.argsort(-value):
        if value[number] <= 0:
            break
        pair = compared.tracklets[number]
        shared = tracklets[pair[0]].shared(tracklets[pair[1]])
        if not any(_conflict(compared.tracklets[other], pair, shared, tracklets) for other, _ in chosen):
            chosen.append((int(number), float(value[number])))
    return chosen


def _conflict(
    other: Int[np.ndarray, " 2"], pair: Int[np.ndarray, " 2"], shared: range, tracklets: Sequence[ViewTracklet]
) -> bool:
    if np.count_nonzero(other == pair) != 1:
        return False
    theirs = tracklets[other[0]].shared(tracklets[other[1]])
    return max(theirs.start, shared.start) < min(theirs.stop, shared.stop)


def _total(support: Sequence[tuple[int, float]]) -> float:
    return sum((value for _, value in support), 0.0)


def _essential(compared: _Compared, chosen: Int[np.ndarray, " pairs"]) -> Float[np.ndarray, "3 3"] | None:
    """Essential matrix of the points of some pairs of tracklets, by RANSAC."""
    rows = np.flatnonzero(np.isin(compared.owner, chosen))
    if len(rows) > _DRAWN:
        rows = np.random.default_rng(_SEED).choice(rows, _DRAWN, replace=False)
    tolerance = float(np.median(compared.tolerance[rows]))
    cv2.setRNGSeed(_SEED)
    matrices, _ = cv2.findEssentialMat(
        compared.left[rows], compared.right[rows], np.eye(3), method=cv2.RANSAC, prob=0.999, threshold=tolerance / 2,
        maxIters=500,
    )  # fmt: skip
    # Several solutions are stacked; the first is as good as any here, for all pairs of tracklets judge it.
    return None if matrices is None or len(matrices) < 3 else np.asarray(matrices[:3])


def _posed(
    cameras: tuple[int, int],
    compared: _Compared,
    tracklets: Sequence[ViewTracklet],
    essential: Float[np.ndarray, "3 3"],
) -> RelativePose | None:
    """Relative pose of an essential matrix: the solution with the points in front of both cameras."""
    support = _support(compared, tracklets, essential)
    chosen = np.array([number for number, _ in support])
    rows = np.isin(compared.owner, chosen)
    rows &= sampson(essential, compared.left, compared.right) < compared.tolerance
    left, right = compared.left[rows], compared.right[rows]
    if len(left) < 5 * MIN_INSTANTS:
        return None
    num_front, rotation, translation, _ = cv2.recoverPose(essential, left, right, np.eye(3))
    if num_front < 0.8 * len(left):
        return None
    pose = Rigid3(read_only(rotation), read_only(translation[:, 0]))
    rays = np.column_stack([left, np.ones(len(left))]) @ rotation.T, np.column_stack([right, np.ones(len(right))])
    cosine = (rays[0] * rays[1]).sum(-1) / np.linalg.norm(rays[0], axis=-1) / np.linalg.norm(rays[1], axis=-1)
    angle_deg = float(np.degrees(np.median(np.arccos(np.clip(cosine, -1, 1)))))
    matches = tuple(
        Match(first, second, value)
        for (first, second), value in ((compared.tracklets[number].tolist(), value) for number, value in support)
    )
    total = sum(value for _, value in support)
    overlap = float(compared.overlap[chosen].sum())
    return RelativePose(*cameras, pose, matches, total, angle_deg, MAX_COST * (1.0 - total / overlap))
