"""Candidates for the sides of a limb pair in a frame, the views whose labels are exchanged, and their positions.

The rays of two views agree on a joint if they pass near each other. A pair of views with one label exchanged is better
off exchanged in one of them. The best labels of all views minimise the sum over pairs of views, as the energy of an
Ising model. Left and right of the whole body are left open: views count from the first one that sees the limbs.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from pipeline.association.identity.limbs import LimbPair

NUM_CANDIDATES = 4
"""Labels of the views that are kept in each frame."""
SCALE_M = 0.10
"""Distance from a ray at which a view counts by half: c of the function of Geman and McClure."""
_BEAM = 16
# Rays at an angle below 3 degrees pass near each other whatever they show.
_LEAST_SINE2 = 0.003


class SideCandidates(NamedTuple):
    """Candidates in each frame, from the best one on, and what the views see there."""

    exchanged: Bool[np.ndarray, "frames candidates cameras"]  # Views whose labels are exchanged
    # Sum over the pairs of views against no exchange, in observations with score 1; infinite where there is no
    # further candidate
    cost: Float[np.ndarray, "frames candidates"]
    label_weight: Float[np.ndarray, "frames cameras"]  # Weight of each view's labels, 0 where it sees no limb
    is_located: Bool[np.ndarray, " frames"]  # Frames in which two views see two joints each


class SeenRays(NamedTuple):
    """Rays of a person's joints in some frames."""

    direction: Float[np.ndarray, "frames cameras joints 3"]  # Unit vectors in the world; 0 where nothing is seen
    weight: Float[np.ndarray, "frames cameras joints"]  # Square of the score; 0 where nothing is seen
    center_m: Float[np.ndarray, "cameras 3"]  # Centres of the cameras in the world

    def select_joints(self, joints: list[int]) -> "SeenRays":
        """Rays of some joints."""
        return SeenRays(self.direction[:, :, joints], self.weight[:, :, joints], self.center_m)


def find_candidates(rays: SeenRays, limbs: LimbPair) -> SideCandidates:
    """Find the labels of the views that agree best, a view after the other, with the best ``_BEAM`` kept."""
    gain = _gains(rays, limbs)
    weight = rays.weight[:, :, limbs.both]
    sees = (weight > 0).sum(-1) >= 2
    num_frames, num_cameras = sees.shape
    exchanged, cost = np.zeros((num_frames, 1, num_cameras), bool), np.zeros((num_frames, 1))
    is_first = np.ones(num_frames, bool)
    for camera in range(num_cameras):
        pairs = gain[:, None, camera, :camera]
        before = exchanged[:, :, :camera]
        kept, other = np.where(before, pairs, 0.0).sum(-1), np.where(before, 0.0, pairs).sum(-1)
        may_exchange = (sees[:, camera] & ~is_first)[:, None]
        following = np.concatenate([exchanged, exchanged], axis=1)
        following[:, exchanged.shape[1] :, camera] = True
        costs = np.concatenate([cost + kept, np.where(may_exchange, cost + other, np.inf)], axis=1)
        best = np.argsort(costs, axis=1, kind="stable")[:, :_BEAM]
        exchanged = np.take_along_axis(following, best[..., None], axis=1)
        cost = np.take_along_axis(costs, best, axis=1)
        is_first &= ~sees[:, camera]
    missing = max(0, NUM_CANDIDATES - cost.shape[1])
    exchanged = np.concatenate([exchanged, np.repeat(exchanged[:, :1], missing, axis=1)], axis=1)
    cost = np.concatenate([cost, np.full((num_frames, missing), np.inf)], axis=1)
    kept = exchanged[:, :NUM_CANDIDATES], cost[:, :NUM_CANDIDATES]
    return SideCandidates(*kept, weight.mean(-1), sees.sum(-1) >= 2)


def _gains(rays: SeenRays, limbs: LimbPair) -> Float[np.ndarray, "frames cameras cameras"]:
    """Loss of agreement if one view of each pair is exchanged; negative where the pair agrees better then.

    A joint of a view is compared with both of the other view, and counts where all three are seen.
    """
    num_frames, num_cameras = rays.weight.shape[:2]
    gain = np.zeros((num_frames, num_cameras, num_cameras))
    for first in range(num_cameras - 1):
        total = np.zeros((num_frames, num_cameras - first - 1))
        for left, right in zip(limbs.left, limbs.right, strict=True):
            far, weight = _far(rays, first, [left, right])
            for here, there in (((0, 0), (0, 1)), ((1, 1), (1, 0)), ((0, 0), (1, 0)), ((1, 1), (0, 1))):
                least = np.minimum(weight[..., *here], weight[..., *there])
                total += least * (far[..., *there] - far[..., *here]) / 2
        gain[:, first, first + 1 :] = gain[:, first + 1 :, first] = total
    return gain


def _far(
    rays: SeenRays, first: int, sides: list[int]
) -> tuple[Float[np.ndarray, "frames later 2 2"], Float[np.ndarray, "frames later 2 2"]]:
    """Distances between rays of a joint's two sides in a view and in all later ones, from 0 to 1; and their weights."""
    direction, weight = rays.direction[:, first:, sides], rays.weight[:, first:, sides]
    here, there = direction[:, :1], direction[:, 1:].swapaxes(-1, -2)
    sine2 = 1.0 - (here @ there) ** 2
    baseline_m = rays.center_m[first + 1 :] - rays.center_m[first]
    apart_m2 = (np.cross(baseline_m[:, None], here) @ there) ** 2
    apart_m2 = np.where(sine2 > _LEAST_SINE2, apart_m2 / np.maximum(sine2, _LEAST_SINE2), 0.0)
    return apart_m2 / (apart_m2 + SCALE_M**2), np.sqrt(weight[:, :1, :, None] * weight[:, 1:, None])


# Scales of the function of Geman and McClure, one a step.
_SCALES_M = (0.3, 0.2, SCALE_M, SCALE_M)
# Least eigenvalue of the normal equations, in views with score 1: below, the rays do not tell the depth.
_LEAST_EIGENVALUE = 0.01
_INERTIA = 1e-9


class LocatedLimbs(NamedTuple):
    """Limbs as candidates locate them."""

    # Joints of the left and right limb in the world in metres, NaN where fewer than two views see one
    xyz_m: Float[np.ndarray, "frames candidates 2 joints 3"]
    residual: Float[np.ndarray, "frames candidates"]  # Disagreement of the views, in observations with score 1


def locate_limbs(
    rays: SeenRays, limbs: LimbPair, exchanged: Bool[np.ndarray, "frames candidates cameras"]
) -> LocatedLimbs:
    """Triangulate the joints of both limbs for each candidate, robustly (iteratively reweighted least squares)."""
    here = exchanged[..., None]
    direction = np.where(
        here[..., None], rays.direction[:, None, :, limbs.exchanged], rays.direction[:, None, :, limbs.both]
    )
    weight = np.where(here, rays.weight[:, None, :, limbs.exchanged], rays.weight[:, None, :, limbs.both])
    across = np.eye(3) - direction[..., :, None] * direction[..., None, :]
    is_located = (weight > 0).sum(2) >= 2
    robust = weight
    for scale_m in _SCALES_M:
        normal = (robust[..., None, None] * across).sum(2) + _INERTIA * np.eye(3)
        right = np.einsum("fkcj,fkcjab,cb->fkja", robust, across, rays.center_m)
        xyz_m = np.linalg.solve(normal, right[..., None])[..., 0]
        off_m = np.einsum("fkcjab,fkcjb->fkcja", across, xyz_m[:, :, None] - rays.center_m[:, None])
        off_m2 = (off_m**2).sum(-1)
        robust = weight * (scale_m**2 / (off_m2 + scale_m**2)) ** 2
    residual = np.where(is_located[:, :, None], weight * off_m2 / (off_m2 + SCALE_M**2), 0.0).sum((2, 3))
    is_located &= np.linalg.eigvalsh(normal)[..., 0] > _LEAST_EIGENVALUE
    xyz_m = np.where(is_located[..., None], xyz_m, np.nan)
    return LocatedLimbs(xyz_m.reshape(*xyz_m.shape[:2], 2, len(limbs.left), 3), residual)
