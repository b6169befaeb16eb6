"""SideCandidates for the sides of a limb pair in a frame: the views whose labels are exchanged.

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
    """SideCandidates in each frame, from the best one on."""

    exchanged: Bool[np.ndarray, "frames candidates cameras"]  # Views whose labels are exchanged
    # Sum over the pairs of views against that of no exchange, in observations with score 1; infinite where there is no
    # further candidate
    cost: Float[np.ndarray, "frames candidates"]


class SeenRays(NamedTuple):
    """Rays of a person's joints in some frames."""

    direction: Float[np.ndarray, "frames cameras joints 3"]  # Unit vectors in the world; 0 where nothing is seen
    weight: Float[np.ndarray, "frames cameras joints"]  # Square of the score; 0 where nothing is seen
    center_m: Float[np.ndarray, "cameras 3"]  # Centres of the cameras in the world

    def within(self, frames: slice) -> "SeenRays":
        """Rays in a slice of the frames."""
        return SeenRays(self.direction[frames], self.weight[frames], self.center_m)

    def of_joints(self, joints: list[int]) -> "SeenRays":
        """Rays of some joints."""
        return SeenRays(self.direction[:, :, joints], self.weight[:, :, joints], self.center_m)


def find_candidates(rays: SeenRays, limbs: LimbPair) -> SideCandidates:
    """Find the labels of the views that agree best, a view after the other, with the best ``_BEAM`` kept."""
    gain = _gains(rays, limbs)
    sees = (rays.weight[:, :, limbs.both] > 0).sum(-1) >= 2
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
    return SideCandidates(exchanged[:, :NUM_CANDIDATES], cost[:, :NUM_CANDIDATES])


def _gains(rays: SeenRays, limbs: LimbPair) -> Float[np.ndarray, "frames cameras cameras"]:
    """Loss of agreement if one view of each pair is exchanged; negative where the pair agrees better then.

    A joint of a view is compared with both of the other view, and counts where all three are seen.
    """
    num_frames, num_cameras = rays.weight.shape[:2]
    gain = np.zeros((num_frames, num_cameras, num_cameras))
    for first in range(num_cameras):
        for second in range(first + 1, num_cameras):
            total = np.zeros(num_frames)
            for left, right in zip(limbs.left, limbs.right, strict=True):
                far, weight = _far(rays, first, second, left, right)
                for here, there in (((0, 0), (0, 1)), ((1, 1), (1, 0)), ((0, 0), (1, 0)), ((1, 1), (0, 1))):
                    total += np.minimum(weight[here], weight[there]) * (far[there] - far[here]) / 2
            gain[:, first, second] = gain[:, second, first] = total
    return gain


def _far(
    rays: SeenRays, first: int, second: int, left: int, right: int
) -> tuple[Float[np.ndarray, "2 2 frames"], Float[np.ndarray, "2 2 frames"]]:
    """Distances between the rays of a joint's two sides in two views, from 0 to 1, and the weights of the pairs."""
    sides = [left, right]
    here, there = rays.direction[:, first, sides], rays.direction[:, second, sides]
    normal = np.cross(here[:, :, None], there[:, None])
    sine2 = (normal**2).sum(-1)
    apart_m2 = (normal @ (rays.center_m[second] - rays.center_m[first])) ** 2
    apart_m2 = np.where(sine2 > _LEAST_SINE2, apart_m2 / np.maximum(sine2, _LEAST_SINE2), 0.0)
    weight = np.sqrt(rays.weight[:, first, sides][:, :, None] * rays.weight[:, second, sides][:, None])
    return np.moveaxis(apart_m2 / (apart_m2 + SCALE_M**2), 0, -1), np.moveaxis(weight, 0, -1)
