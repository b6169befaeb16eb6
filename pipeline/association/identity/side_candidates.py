"""Candidates for the sides of a limb pair in a frame, the views whose labels are exchanged, and their positions.

The rays of two views agree on a joint if they pass near each other. A pair of views with one label exchanged is better
off exchanged in one of them. The best labels of all views minimise the sum over pairs of views, as the energy of an
Ising model. Left and right of the whole body are left open: views count from the first one that sees the limbs.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from pipeline.association.identity.limbs import LimbPair
from pipeline.association.identity.side_kernels import add_gains
from pipeline.motion.skeleton.fitting.fit_kernels import sum_normal_equations

NUM_CANDIDATES = 4
"""Labels of the views that are kept in each frame."""
SCALE_M = 0.10
"""Distance from a ray at which a view counts by half: c of the function of Geman and McClure."""
_BEAM = 16


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
        pairs, before = gain[:, camera, :camera, None], exchanged[:, :, :camera].astype(float)
        kept, other = (before @ pairs)[..., 0], ((1.0 - before) @ pairs)[..., 0]
        may_exchange = (sees[:, camera] & ~is_first)[:, None]
        costs = np.concatenate([cost + kept, np.where(may_exchange, cost + other, np.inf)], axis=1)
        best = np.argsort(costs, axis=1, kind="stable")[:, :_BEAM]
        is_exchanged, kept_row = np.divmod(best, cost.shape[1])
        exchanged = exchanged[np.arange(num_frames)[:, None], kept_row]
        exchanged[:, :, camera] = is_exchanged
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
    moment_m = np.cross(rays.center_m[:, None], rays.direction)
    lines = np.concatenate([rays.direction, moment_m, np.sqrt(rays.weight)[..., None]], axis=-1)
    lines = lines.transpose(2, 0, 3, 1).copy()
    for left, right in zip(limbs.left, limbs.right, strict=True):
        add_gains(lines[left], lines[right], SCALE_M, gain)
    return gain


# Scales of the function of Geman and McClure, one a step; in the first step all rays count.
_SCALES_M = (1e9, 0.3, 0.2, SCALE_M)
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
    shape = (*exchanged.shape[:2], len(limbs.both))
    here = exchanged[:, :, None]
    direction, weight = rays.direction.swapaxes(1, 2)[:, None], rays.weight.swapaxes(1, 2)[:, None]
    direction = np.where(here[..., None], direction[:, :, limbs.exchanged], direction[:, :, limbs.both])
    weight = np.where(here, weight[:, :, limbs.exchanged], weight[:, :, limbs.both])
    direction, weight = direction.reshape(-1, *direction.shape[3:]), weight.reshape(-1, weight.shape[3])
    xyz_m, normal, right = np.zeros((len(weight), 3)), np.empty((len(weight), 3, 3)), np.empty((len(weight), 3))
    for scale_m in _SCALES_M:
        sum_normal_equations(direction, rays.center_m, weight, xyz_m, scale_m, normal, right)
        normal += _INERTIA * np.eye(3)
        xyz_m[:] = np.linalg.solve(normal, right[..., None])[..., 0]
    from_center_m = xyz_m[:, None] - rays.center_m
    along_m2 = np.vecdot(direction, from_center_m) ** 2
    off_m2 = np.maximum(np.vecdot(from_center_m, from_center_m) - along_m2, 0.0)
    is_located = (weight > 0).sum(-1) >= 2
    residual = np.where(is_located, (weight * off_m2 / (off_m2 + SCALE_M**2)).sum(-1), 0.0).reshape(shape).sum(-1)
    is_located &= np.linalg.eigvalsh(normal)[:, 0] > _LEAST_EIGENVALUE
    xyz_m[~is_located] = np.nan
    return LocatedLimbs(xyz_m.reshape(*shape[:2], 2, len(limbs.left), 3), residual)
